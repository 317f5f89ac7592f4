"""Motion of the heart over the cycle from grey levels."""
