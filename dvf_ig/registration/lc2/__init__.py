"""LC2: local linear combination of two model channels, as a function of the pose."""
