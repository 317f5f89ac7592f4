"""Measured realism of the synthetic world."""
