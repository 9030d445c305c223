"""Samples as they arrive -> file (SPEC clause 15)."""
