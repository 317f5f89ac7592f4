"""Recordings: signals, tracked images and poses, calibration phantoms, a whole scenario."""
