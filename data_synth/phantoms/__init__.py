"""Calibration phantoms and their recordings."""
