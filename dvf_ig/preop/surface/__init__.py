"""Closed surfaces: extracted from labels, repaired, with normals."""
