"""Sums over images and volumes: blocks, averages to a coarser pitch, and the banded sums of a spline fit."""
