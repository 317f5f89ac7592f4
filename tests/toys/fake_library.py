"""Shared libraries with the vendors' symbols, compiled from tests/guidance/servo."""

import mmap
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

SOURCES = Path(__file__).parents[1] / "guidance" / "servo"
POSITION, FORCE, BROKEN, HANG_S, BUTTON, WATCHDOG, COUNT, ENABLES = 0, 3, 6, 7, 8, 9, 10, 11
LOG, KEPT = 16, 200_000
"""Offsets in the file of FAKE_DHD, as in fake_dhd.c."""


def compiled(source: str, folder: Path, name: str | None = None) -> Path:
    """The library of a source; the test is skipped without a C compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (cc), so no library with the vendor's symbols can be made")
    library = folder / (name or f"{source}.so")
    flags = ["-shared", "-fPIC", "-O1", "-pthread"]
    subprocess.run([compiler, *flags, str(SOURCES / f"{source}.c"), "-o", str(library), "-lm"], check=True)
    return library


class SharedDhd:
    """State of a fake Force Dimension device, shared with the process that drives it.

    Args:
        path: of a new file; the driving process gets it as FAKE_DHD.
        xyz_mm: position of the device.
    """

    def __init__(self, path: Path, xyz_mm: tuple[float, float, float]) -> None:
        size = 8 * (LOG + 2 * KEPT)
        path.write_bytes(bytes(size))
        file = os.open(path, os.O_RDWR)
        self.numbers = np.frombuffer(mmap.mmap(file, size), dtype=np.float64)
        os.close(file)
        self.path = path
        self.numbers[POSITION : POSITION + 3] = 1e-3 * np.array(xyz_mm)

    @property
    def log(self) -> np.ndarray:
        """(n, 2) time by the monotonic clock (s) and size (N) of each force."""
        count = int(self.numbers[COUNT])
        assert count <= KEPT
        return self.numbers[LOG : LOG + 2 * count].reshape(-1, 2).copy()
