"""Landmark registration: touched points, and how they are found in a stylus stream."""
