"""Export of a run for other programs: 3D Slicer, ROS 2 (MCAP), Rerun."""
