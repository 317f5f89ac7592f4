"""Read the matrix of an ITK transform file: one affine transform as text here, everything else by ITK.

ITK crashes or hangs on some damaged files, so it reads in a separate process with limits of time and memory.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError

from .limits import SETTINGS_BYTES
from .reading import read_bytes

_AFFINE = ("AffineTransform", "MatrixOffsetTransformBase")
_CENTER = {"TranslationTransform": (0,), "IdentityTransform": (0,), "Euler3DTransform": (3, 4)}
"""Numbers of FixedParameters of types that do not have a centre of three."""
_NOT_LINEAR = re.compile(r"BSpline|Displacement|Velocity|Kernel|Spline|Warp|Polynomial", re.IGNORECASE)
_TEXT = b"#Insight"
_HDF5 = b"\x89HDF\r\n\x1a\n"
_SECONDS, _MEMORY_BYTES = 20, 2 << 30
_CHILD = """
import json, resource, sys
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]), int(sys.argv[2])))
import SimpleITK
transform = SimpleITK.ReadTransform(sys.argv[1])
if transform.GetDimension() != 3 or not transform.IsLinear():
    print("null")
else:
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    print(json.dumps([transform.TransformPoint(corner) for corner in corners]))
"""


def is_itk_text(path: Path) -> bool:
    """Return whether a file begins as ITK's text of transforms does."""
    with path.open("rb") as stream:
        return stream.read(len(_TEXT)) == _TEXT


def linear_matrix(path: Path) -> FloatArray:
    """Read the (4, 4) LPS matrix of a linear 3-D transform, source to target; exact for affine text.

    Raises:
        UnreadableFileError: not an ITK transform, truncated, or another kind of transform.
    """
    with path.open("rb") as stream:
        begin = stream.read(8)
    if begin == _TEXT:
        if path.stat().st_size > SETTINGS_BYTES:
            raise UnreadableFileError(f"{path} is too long for the text of a linear transform")
        text = read_bytes(path, "an ITK transform").decode("ascii", "replace")
        exact = _affine_text(path, text)
        return _by_itk(path) if exact is None else exact
    if begin != _HDF5 and path.suffix.lower() != ".mat":
        raise UnreadableFileError(f"{path} is not a readable ITK transform; write it as .tfm again")
    return _by_itk(path)


def _affine_text(path: Path, text: str) -> FloatArray | None:
    """Parse the matrix of one affine transform; None for other transforms whose text is complete.

    Raises:
        UnreadableFileError: truncated text, or numbers that are missing, superfluous or not finite.
    """
    lines = [line.partition(":")[::2] for line in text.splitlines() if line.strip() and line[0] != "#"]
    rows = [(name.strip(), value.split()) for name, value in lines]
    kinds = [words[0].partition("_")[0] for name, words in rows if name == "Transform" and words]
    simple = [kind for kind in kinds if kind != "CompositeTransform"]
    parameters = [_numbers(path, words) for name, words in rows if name == "Parameters"]
    centers = [_numbers(path, words) for name, words in rows if name == "FixedParameters"]
    counts = all(len(c) in _CENTER.get(kind, (3,)) for kind, c in zip(simple, centers, strict=False))
    if len(simple) > 1 and kinds[0] != "CompositeTransform":
        raise UnreadableFileError(
            f"{path} holds {len(simple)} transforms and does not say that they are applied one after the "
            "other (CompositeTransform); keep the one that is meant"
        )
    if other := [kind for kind in simple if _NOT_LINEAR.search(kind)]:
        raise UnreadableFileError(f"{path} holds a {other[0]}, which is not linear; needed a rigid transform")
    if any("_2_2" in words[0] for name, words in rows if name == "Transform" and words):
        raise UnreadableFileError(f"{path} holds a transform of 2-D images; needed a rigid one in 3-D")
    if not simple or not len(simple) == len(parameters) == len(centers) or not counts or text[-1] != "\n":
        raise UnreadableFileError(
            f"{path} is cut off or damaged: {len(kinds)} transforms, {len(parameters)} lines of Parameters, "
            f"{len(centers)} of FixedParameters; needed equal numbers and a final line break: write it again"
        )
    if len(kinds) != 1 or kinds[0] not in _AFFINE:
        return None
    numbers, center = parameters[0], centers[0]
    if numbers.size != 12:
        raise UnreadableFileError(f"{path} is not a linear 3-D transform; needed a rigid one")
    matrix = np.eye(4)
    matrix[:3, :3] = numbers[:9].reshape(3, 3)
    matrix[:3, 3] = numbers[9:] + center - matrix[:3, :3] @ center
    return matrix


def _numbers(path: Path, words: list[str]) -> FloatArray:
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.array([np.nan])
    if not (np.abs(numbers) < 1e12).all():
        raise UnreadableFileError(f"{path}: '{' '.join(words)[:60]}' are not finite numbers; write it again")
    return numbers


def _by_itk(path: Path) -> FloatArray:
    """Read the matrix with ITK in a separate process."""
    command = [sys.executable, "-W", "ignore", "-c", _CHILD, str(path.resolve()), str(_MEMORY_BYTES)]
    try:
        process = subprocess.run(command, capture_output=True, timeout=_SECONDS, check=False)
    except subprocess.TimeoutExpired as exc:
        raise UnreadableFileError(f"{path} was not read within {_SECONDS} s; write it as .tfm again") from exc
    if process.returncode:
        raise UnreadableFileError(f"{path} is not a readable ITK transform; write it as .tfm again")
    corners = json.loads(process.stdout.splitlines()[-1])
    if corners is None:
        raise UnreadableFileError(f"{path} is not a linear 3-D transform; needed a rigid one")
    places = np.array(corners, dtype=np.float64)
    if not (np.abs(places) < 1e12).all():
        raise UnreadableFileError(f"{path} holds numbers that are not finite; write it as .tfm again")
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = (places[1:] - places[0]).T, places[0]
    return matrix
