"""Motion of the heart over the cycle, estimated from grey levels."""
