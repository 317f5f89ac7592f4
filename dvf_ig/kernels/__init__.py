"""Compiled kernels on plain arrays: spline (eq. 1), force laws (eqs 4–9), dynamic force (eqs 10–11), LC2."""
