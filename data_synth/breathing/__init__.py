"""Breathing: breaths over time, the motion of the heart in them, and what is recorded of them."""
