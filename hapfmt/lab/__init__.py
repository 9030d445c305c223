"""Tools for research: simulated scenes, subjective tests, comparisons and pictures."""
