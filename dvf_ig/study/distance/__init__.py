"""Ways to make a distance map, side by side."""
