"""Spatial calibration of a tracked probe: N-wire, cross-wire, wall."""
