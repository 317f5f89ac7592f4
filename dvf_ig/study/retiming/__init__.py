"""Uniform against two-segment retiming."""
