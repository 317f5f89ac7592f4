"""Where things are: frames, points, poses, surfaces and images."""
