"""A vendor's shared library: found, or refused with what to do."""

import ctypes
import os
from collections.abc import Sequence
from pathlib import Path

from dvf_ig.core import InvalidInputError


class VendorLibraryError(InvalidInputError):
    """A vendor's library is missing, does not load or lacks a function, or its device does not open."""


def load_vendor_library(
    vendor: str, names: Sequence[str], functions: Sequence[str], advice: str, path: str | Path | None
) -> ctypes.CDLL:
    """The library, with all functions that are used.

    Args:
        vendor: for messages.
        names: of the file, tried in order as the system's loader finds them; unless `path` is given.
        functions: that it must export.
        advice: what to do if it is missing.
        path: of the file itself.
    Raises:
        VendorLibraryError: it is missing, does not load, or lacks a function.
    """
    tried: list[str] = []
    for name in [str(path)] if path is not None else names:
        try:
            library = ctypes.CDLL(os.fspath(name))
        except OSError as exc:
            tried.append(f"{name}: {exc}")
            continue
        missing = [function for function in functions if not hasattr(library, function)]
        if missing:
            raise VendorLibraryError(
                f"{name} lacks {', '.join(missing)}: it is not the library of {vendor}, or another version"
            )
        return library
    raise VendorLibraryError(f"the library of {vendor} was not found; {advice} (tried {'; '.join(tried)})")


def address_of(library: ctypes.CDLL, name: str) -> int:
    """Where a function of the library begins."""
    return ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0
