"""Closed surfaces: from labels, repaired, with normals."""
