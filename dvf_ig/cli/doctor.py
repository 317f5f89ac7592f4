"""`dvf-ig doctor`: what is missing on this machine, how to get it, and the folder of compiled kernels."""

import ctypes.util
import importlib.metadata
import platform
import sys
from dataclasses import dataclass

import typer

from .shell import JsonFlag, command, emit

REQUIRED = (
    "numpy",
    "scipy",
    "SimpleITK",
    "scikit-image",
    "opencv-contrib-python-headless",
    "numba",
    "typer",
    "rich",
    "pydantic",
    "PyYAML",
    "jsonschema",
    "matplotlib",
    "zlib-ng",
)
EXTRAS = {"wfdb": ("ecg", "WFDB records"), "open3d": ("open3d", "points touched on the heart")}
"""Optional packages, with the extra that installs each and its purpose."""
SYSTEM_LIBRARIES = {
    "EGL": "libegl1",
    "GL": "libgl1",
    "X11": "libx11-6",
    "usb-1.0": "libusb-1.0-0",
    "gomp": "libgomp1",
}
"""Shared libraries that open3d loads, with the Debian package of each."""


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check: what was checked, what was found, and how to get it if it is missing."""

    what: str
    found: str | None
    remedy: str
    needed: bool = True


def checks() -> list[Check]:
    """Run all checks, in the order in which a user would fix them."""
    from dvf_ig.core.errors import install_extra

    python = platform.python_version()
    out = [Check("Python >= 3.11", python if sys.version_info >= (3, 11) else None, "install Python 3.11")]
    with_open3d = _version("open3d") is not None
    if sys.platform.startswith("linux"):
        for library, package in SYSTEM_LIBRARIES.items():
            path = ctypes.util.find_library(library)
            remedy = f"sudo apt-get install {package}"
            out.append(Check(f"system library {package}", path, remedy, needed=with_open3d))
    remedy = "run scripts/setup, or pip install . in the folder of the sources"
    out += [Check(f"package {name}", _version(name), remedy) for name in REQUIRED]
    out += [
        Check(f"{name} for {use}", _version(name), install_extra(extra), needed=False)
        for name, (extra, use) in EXTRAS.items()
    ]
    if all(check.found for check in out if check.needed):
        out.append(_kept_kernels())
    return out


def _kept_kernels() -> Check:
    from dvf_ig.kernels.compiled import cache_folder

    folder = cache_folder()
    remedy = (
        "each process compiles its own, which takes some seconds; "
        "set NUMBA_CACHE_DIR to a folder that can be written"
    )
    return Check("folder of compiled kernels", None if folder is None else str(folder), remedy, needed=False)


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def verdict(missing: int, optional: int) -> str:
    """Summarise the readiness of this machine in one sentence."""
    if missing:
        return f"not ready: {_things(missing)} needed and missing; install what is named above, in this order"
    if optional:
        return f"ready; {_things(optional)} optional and missing"
    return "ready: nothing is missing"


def _things(count: int) -> str:
    return "1 thing is" if count == 1 else f"{count} things are"


def doctor(as_json: JsonFlag = False) -> None:
    """Report what is missing on this machine and how to get it (exit 2 if something needed is missing).

    Also report the folder of compiled kernels.
    """
    with command(lists_inputs=False):
        results = checks()
        missing = [c for c in results if c.found is None and c.needed]
        optional = [c for c in results if c.found is None and not c.needed]
        rows = [(c.what, c.found if c.found else f"MISSING: {c.remedy}") for c in results]
        payload = {
            "ok": not missing,
            "verdict": verdict(len(missing), len(optional)),
            "checks": [
                {"what": c.what, "found": c.found, "needed": c.needed, "remedy": c.remedy} for c in results
            ],
        }
        emit(payload, [*rows, ("verdict", verdict(len(missing), len(optional)))], as_json=as_json)
        if missing:
            raise typer.Exit(2)
