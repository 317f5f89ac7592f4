"""Beating anatomy built from real corresponding surfaces."""
