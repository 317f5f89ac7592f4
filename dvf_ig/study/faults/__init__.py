"""Faults put into the streams of a session and its servo: what is detected, and what the force does."""
