"""Whether a registered pose may be used: its checks and its least-constrained direction."""
