"""Training of the spline network, three ways."""
