"""Faults put into a session and its servo."""
