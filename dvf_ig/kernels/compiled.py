"""How every kernel here is compiled: no GIL, cached on disk, division by zero gives inf.

No fast-math: a kernel then gives the same bits on every machine, and its NumPy twin can be held against it.
"""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A function called from Python or from other kernels."""
    compiled: Callable[P, R] = njit(nogil=True, cache=True, error_model="numpy")(function)
    return compiled


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A function called from other kernels only; always merged into its caller."""
    compiled: Callable[P, R] = njit(nogil=True, cache=True, error_model="numpy", forceinline=True)(function)
    return compiled
