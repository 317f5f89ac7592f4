"""Training of the spline network: gradient descent (eq. 3), conjugate gradients, exact least squares."""
