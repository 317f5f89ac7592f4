"""Compilation of the kernels: without the GIL, division by zero gives inf.

Compiled code is kept on disk until a kernel source changes (`dvf_ig/core/kernel_cache.py`).

Kernels are compiled again for read-only arrays, so callers pass writable copies of user data. They copy
arrays element by element: for `a[:] = b` numba compiles its error message, 2 s in each process.

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
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Options of `numba.njit`. No kernel is called from C, and that wrapper would take 5 % of the compile
time."""


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function called from Python or from other kernels."""
    compiled: Callable[P, R] = compile_kernel(function, SOURCES, **OPTIONS)
    return compiled


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function called only from other kernels and always inlined into its caller."""
    compiled: Callable[P, R] = compile_kernel(function, SOURCES, **OPTIONS, forceinline=True)
    return compiled


def separate(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function called from Python or from other kernels: once for all of them, never inlined."""
    compiled: Callable[P, R] = compile_kernel(function, SOURCES, separately=True, **OPTIONS)
    return compiled


def callback(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function called from C by its `address`."""
    return lambda function: compile_callback(function, SOURCES, signature)


def cache_folder() -> Path | None:
    """Return the folder of this folder's compiled kernels; None if none can be written."""
    compiled: Any = kernel(thread_count)  # any function of this folder; it is not called
    folder = compiled.stats.cache_path
    return None if folder is None else Path(folder)


def thread_count() -> int:
    """Return the number of threads to use: all cores, or NUMBA_NUM_THREADS; numba starts no own pool."""
    return int(config.NUMBA_NUM_THREADS)
