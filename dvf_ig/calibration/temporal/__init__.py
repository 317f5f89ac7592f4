"""Temporal calibration: the lag between tracker and video."""
