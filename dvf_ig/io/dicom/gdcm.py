"""Read tags and pixels of DICOM files with SimpleITK's GDCM, in a separate process with limits."""

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
_VALUE_CHARACTERS = 1 << 10
"""Most characters of a requested tag; the longest, a position, has at most 3 x 16."""
_CHILD = """
import json, resource, sys
task = json.loads(sys.stdin.read())
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
resource.setrlimit(resource.RLIMIT_AS, (task["memory"], task["memory"]))
import SimpleITK
SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
SimpleITK.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
out = open(task["pixels"], "wb") if task["pixels"] else None
for path in task["files"]:
    print(json.dumps({"begun": path}), flush=True)
    reader = SimpleITK.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    reader.SetFileName(path)
    reader.ReadImageInformation()
    size = list(reader.GetSize())
    tags = {}
    for tag in task["tags"]:
        if reader.HasMetaDataKey(tag):
            tags[tag] = reader.GetMetaData(tag)[: task["characters"]]
    if out is not None:
        if size[:2] != task["size"] or any(n != 1 for n in size[2:]) or reader.GetNumberOfComponents() != 1:
            sys.exit(3)
        image = SimpleITK.Cast(reader.Execute(), SimpleITK.sitkFloat32)
        out.write(SimpleITK.GetArrayViewFromImage(image).tobytes())
    print(json.dumps({"size": size, "components": reader.GetNumberOfComponents(), "tags": tags}), flush=True)
print(json.dumps({"done": True}))
"""

Header = dict[str, Any]
"""Header of one file: `size` and `components` per pixel as GDCM reads them, `tags` by "group|element"."""


def read_headers(files: Sequence[Path], tags: Sequence[str]) -> list[Header]:
    """Read the requested tags of every file, in the order of the files.

    Raises:
        UnreadableFileError: GDCM cannot read a file, or does not finish in time.
    """
    return _run(files, tags, None, (0, 0))


def read_pixels(files: Sequence[Path], columns: int, rows: int) -> NDArray[np.float32]:
    """Read (n, rows, columns) grey levels, rescaled by the slope and intercept of each file.

    Raises:
        UnreadableFileError: as `read_headers`, or a size other than `columns` x `rows`.
    """
    with tempfile.TemporaryDirectory(prefix="dvf_ig_") as folder:
        raw = Path(folder) / "pixels"
        _run(files, (), raw, (columns, rows))
        values = np.fromfile(raw, dtype=np.float32)
    if values.size != len(files) * rows * columns:
        raise UnreadableFileError(f"{files[0].parent}: pixels are missing; copy the folder again")
    return values.reshape(len(files), rows, columns)


def _run(
    files: Sequence[Path], tags: Sequence[str], pixels: Path | None, size: tuple[int, int]
) -> list[Header]:
    task = {
        "files": [str(file.resolve()) for file in files],
        "tags": list(tags),
        "pixels": None if pixels is None else str(pixels),
        "size": list(size),
        "memory": _MEMORY_BYTES,
        "characters": _VALUE_CHARACTERS,
    }
    command = [sys.executable, "-W", "ignore", "-c", _CHILD]
    try:
        process = subprocess.run(
            command,
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
    return [line for line in lines if "tags" in line]
