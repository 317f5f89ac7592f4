"""Read trigger pulses: one column of times in seconds, with or without a header."""

from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io.reading import read_text


def read_triggers(path: Path | str) -> FloatArray:
    """Times of trigger pulses.

    Args:
        path: text file, one time (s) a line; the first line may be a header.
    Returns:
        (n,) s, in the file's order.
    Raises:
        UnreadableFileError: absent, empty, or a line that is not one number.
    """
    path = Path(path)
    lines = [line.strip().rstrip(",") for line in read_text(path, "a list of trigger times").splitlines()]
    rows = [(number, line) for number, line in enumerate(lines, 1) if line]
    if rows and not _is_number(rows[0][1]):
        rows = rows[1:]
    if not rows:
        raise UnreadableFileError(f"{path} holds no trigger time; needed one time in seconds a line")
    for number, line in rows:
        if not _is_number(line):
            raise UnreadableFileError(f"{path}, line {number}: '{line[:40]}' is not one time in seconds")
    return np.array([float(line) for _, line in rows])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
