"""Numba kernels of the synthetic world, on plain arrays."""
