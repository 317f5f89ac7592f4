"""A wall pressed by a hand on a simulated device: what sampling makes of it, with and without the controller."""
