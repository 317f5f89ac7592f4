"""Compiled kernels on plain arrays: spline (eq. 1), force laws (eqs 4–9), dynamic force (eqs 10–11), LC2."""

from dvf_ig.core.kernel_sources import KernelSources

SOURCES = KernelSources.of_package(__file__)
"""Sources as they are before any kernel is imported."""
