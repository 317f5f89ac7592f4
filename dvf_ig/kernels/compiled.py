"""Compilation of the kernels: without the GIL, division by zero gives inf.

They are kept on disk for as long as no kernel source changes (`dvf_ig/core/kernel_cache.py`).

Kernels are compiled anew for read-only arrays, so callers hand over writable copies of what users give them.
They copy arrays element by element: for `a[:] = b` numba compiles its error message, 2 s in each process.

No fast-math: sums keep their order, NaN keeps its meaning, and a kernel can be tested against NumPy.
The spline works on rows of four (docs/decisions/0006) and uses fused multiply-add where the processor
has it; numba's own settings are left as they are.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from numba import config

from dvf_ig.core.kernel_cache import compile_callback, compile_kernel

from . import SOURCES

P = ParamSpec("P")
R = TypeVar("R")
OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""None is called from C: that wrapper would be a twentieth of the compiling."""


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A function called from Python or from other kernels."""
    compiled: Callable[P, R] = compile_kernel(function, SOURCES, **OPTIONS)
    return compiled


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A function called from other kernels only; always inlined into its caller."""
    compiled: Callable[P, R] = compile_kernel(function, SOURCES, **OPTIONS, forceinline=True)
    return compiled


def callback(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """A function called from C by its `address`."""
    return lambda function: compile_callback(function, SOURCES, signature)


def cache_folder() -> Path | None:
    """Where compiled kernels of this folder are kept; None if no folder for them can be written."""
    compiled: Any = kernel(thread_count)  # any function of this folder; it is not called
    folder = compiled.stats.cache_path
    return None if folder is None else Path(folder)


def thread_count() -> int:
    """Threads that a method may use: all cores, or NUMBA_NUM_THREADS; numba's own pool is not started."""
    return int(config.NUMBA_NUM_THREADS)
