"""A hand on a simulated device against a wall: what sampling does, with and without the controller."""
