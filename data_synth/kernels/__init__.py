"""Numba kernels of the synthetic world, on plain arrays."""

from dvf_ig.core.kernel_sources import KernelSources

SOURCES = KernelSources.of_package(__file__)
"""Sources as they are before any kernel is imported."""
