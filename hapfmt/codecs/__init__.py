"""Packets <-> counts, normative both ways where the bits are fixed (SPEC clause 9)."""
