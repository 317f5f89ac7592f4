"""Triangle meshes and surface series: OBJ, STL, PLY, VTP."""
