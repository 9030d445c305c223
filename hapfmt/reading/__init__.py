"""File -> recording: what is where, packets through any damage, decoded channels (SPEC 10, 14)."""
