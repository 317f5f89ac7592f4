"""Pose and change of shape fitted together, over blocks of space."""
