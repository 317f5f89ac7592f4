"""Whether a registration may be believed: its checks and its least-constrained direction."""
