"""Pivot calibration: the tool tip."""
