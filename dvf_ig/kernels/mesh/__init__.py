"""Distance to a triangle mesh: closest points in a tree, and the winding number that gives its sign."""
