"""PLUS and 3D Slicer recordings: tracked sequences, device sets, calibration data."""
