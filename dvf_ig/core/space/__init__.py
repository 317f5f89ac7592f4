"""Geometry: frames, points, poses, surfaces and images."""
