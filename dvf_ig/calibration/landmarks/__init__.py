"""Landmark registration: touched points, and their detection in a stylus stream."""
