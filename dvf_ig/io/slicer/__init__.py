"""3D Slicer scenes: the scene file, and the files of its nodes."""
