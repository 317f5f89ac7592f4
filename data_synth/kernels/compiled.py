"""Compilation of the kernels of the synthetic world; kept on disk as in `dvf_ig/core/kernel_cache.py`."""

from collections.abc import Callable
from typing import Any

from dvf_ig.core.kernel_cache import compile_callback, compile_kernel

from . import SOURCES


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function called from Python or from other kernels; `options` are those of `numba.njit`."""
    return lambda function: compile_kernel(function, SOURCES, **options)


def callback(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function called from C by its `address`."""
    return lambda function: compile_callback(function, SOURCES, signature)
