"""File -> values at the device's rate."""
