"""Samples as they arrive -> file (SPEC clause 13)."""
