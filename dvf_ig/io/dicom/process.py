"""Run the process that reads DICOM files (`child`), with limits of time and memory."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core.errors import UnreadableFileError

_SECONDS, _SECONDS_A_FILE, _MEMORY_BYTES = 30.0, 0.1, 4 << 30
"""Time and memory limits: a file takes 1 to 5 ms from a disk, some tens of ms from a busy network drive."""
_CHILD = Path(__file__).with_name("child.py")

Tags = dict[str, Any]
"""Tags of a file by keyword: `general`, whether it is `enhanced`, and those of its `frames`."""


def read_tags(files: Sequence[Path]) -> list[Tags]:
    """Read the tags of every file, in the order of the files.

    Raises:
        UnreadableFileError: a file cannot be read, or reading does not finish in time.
    """
    return [line["tags"] for line in _run(files, None, (0, 0)) if "tags" in line]


def read_pixels(files: Sequence[Path], frames: int, columns: int, rows: int) -> NDArray[np.float32]:
    """Read (frames, rows, columns) grey levels, rescaled by the slope and intercept of each file.

    Args:
        frames: of all files together.
    Raises:
        UnreadableFileError: as `read_tags`, other than `columns` x `rows`, or another number of frames.
    """
    with tempfile.TemporaryDirectory(prefix="dvf_ig_") as folder:
        raw = Path(folder) / "pixels"
        _run(files, raw, (columns, rows))
        values = np.fromfile(raw, dtype=np.float32)
    if values.size != frames * rows * columns:
        raise UnreadableFileError(f"{files[0].parent}: pixels are missing; copy the folder again")
    return values.reshape(frames, rows, columns)


def _run(files: Sequence[Path], pixels: Path | None, size: tuple[int, int]) -> list[dict[str, Any]]:
    task = {
        "files": [str(file.resolve()) for file in files],
        "pixels": None if pixels is None else str(pixels),
        "size": list(size),
        "memory": _MEMORY_BYTES,
    }
    try:
        process = subprocess.run(
            [sys.executable, "-P", "-W", "ignore", str(_CHILD)],
            input=json.dumps(task).encode(),
            capture_output=True,
            timeout=_SECONDS + _SECONDS_A_FILE * len(files),
            check=False,
        )
        output = process.stdout
    except subprocess.TimeoutExpired as exc:
        output = exc.stdout or b""
    lines = [json.loads(line) for line in output.splitlines() if line.endswith(b"}")]
    if not lines or "done" not in lines[-1]:
        begun = sum("begun" in line for line in lines)
        culprit = files[max(begun - 1, 0)]
        raise UnreadableFileError(
            f"{culprit} is not a readable DICOM image; export it again, or take it out of the folder"
        )
    return lines
