"""3D Slicer scenes: the scene file, and what its nodes read."""
