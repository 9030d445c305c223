"""What research needs: simulated scenes, subjective tests, comparisons and pictures."""
