"""Rigid transforms as ITK files with a JSON sidecar that names their frames."""

from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import FrameMismatchError, InvalidInputError, OutputError
from dvf_ig.core.space.rigid import Rigid, rigidity_defect

from . import limits
from .itk_transform import linear_matrix
from .json_file import read_json
from .reading import reading, refuse_lfs_pointer
from .sidecar import write_sidecar
from .writing.atomic import atomic_file, write_text
from .writing.listing import require_outputs

CONVENTION = "ITK: maps points of 'from' (fixed image) to 'to' (moving image); LPS, mm"


def read_transform(path: Path | str, target: str | None = None, source: str | None = None) -> Rigid:
    """Read target_from_source from an ITK transform file (`.tfm`, `.txt`, `.h5`, `.mat`).

    Direction: an ITK transform takes points of the *fixed* image to the *moving* image, both LPS in mm; that
    is how resampling filters use it. Here fixed is the source frame and moving the target frame, so the
    matrix in the file is target_from_source itself, p_target = A (p_source − c) + t + c. (3D Slicer shows
    the inverse, because its "transform to parent" runs from moving to fixed, in RAS.)

    Args:
        path: the transform; its frames are read from the sidecar `<stem>.json` beside it.
        target, source: needed where there is no sidecar; where there is one they must agree with it.
    Raises:
        UnreadableFileError: absent, not a linear ITK transform, or not rigid.
        FrameMismatchError: the sidecar names other frames.
        InvalidInputError: no sidecar and no frames given.
    """
    path = Path(path)
    refuse_lfs_pointer(path)
    sidecar = path.with_suffix(".json")
    recorded = _sidecar_frames(sidecar) if sidecar.is_file() and sidecar != path else None
    if recorded is not None:
        recorded_target, recorded_source = recorded
        wanted = (target or recorded_target, source or recorded_source)
        if wanted != (recorded_target, recorded_source):
            raise FrameMismatchError(
                f"{path} is {recorded_target}_from_{recorded_source}; needed {wanted[0]}_from_{wanted[1]}: "
                f"invert it, or correct the names in {sidecar.name}"
            )
        target, source = wanted
    elif path.is_file() and (target is None or source is None):
        raise InvalidInputError(
            f"{path}: its frames are not known; put beside it a file {sidecar.name} with "
            '{"from": "<fixed frame>", "to": "<moving frame>"}'
        )
    with reading(path, "an ITK transform"):
        matrix = linear_matrix(path)
        return rigid_from_matrix(matrix, target or "target", source or "source")


def write_transform(rigid: Rigid, path: Path | str, error_mm: float | None = None) -> None:
    """Write target_from_source as an ITK text transform and its sidecar `<stem>.json`.

    Raises:
        OutputError: an ending other than `.tfm` or `.txt`, or not writable.
    """
    path = Path(path)
    if path.suffix.lower() not in (".tfm", ".txt"):
        raise OutputError(f"cannot write {path}: transforms are written as .tfm; change the ending")
    require_outputs(path, path.with_suffix(".json"))
    write_text(path, affine_text(rigid.matrix))
    sidecar = {"from": rigid.source, "to": rigid.target, "convention": CONVENTION, "error_mm": error_mm}
    write_sidecar(path.with_suffix(".json"), sidecar, "transform")


def affine_text(matrix: FloatArray) -> str:
    """A (4, 4) affine matrix as the text of an ITK transform, every digit kept."""
    numbers = " ".join(map(repr, [*matrix[:3, :3].ravel().tolist(), *matrix[:3, 3].tolist()]))
    return (
        "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\n"
        f"Parameters: {numbers}\nFixedParameters: 0 0 0\n"
    )


def write_transforms(rigid: Rigid, path: Path | str, error_mm: float | None = None) -> tuple[Path, Path]:
    """Write target_from_source as `.tfm` and, beside it, the same as `.h5`, which 3D Slicer saves itself.

    Returns:
        The two files; one sidecar `<stem>.json` belongs to both.
    Raises:
        OutputError: as `write_transform`, or a file of the user's own stands beside it.
    """
    import SimpleITK

    path = Path(path)
    second = path.with_suffix(".h5")
    require_outputs(second)
    write_transform(rigid, path, error_mm)
    affine = SimpleITK.AffineTransform(3)
    affine.SetMatrix(rigid.rotation.ravel().tolist())
    affine.SetTranslation(rigid.translation_mm.tolist())
    try:
        with atomic_file(second) as temporary:
            SimpleITK.WriteTransform(affine, str(temporary))
    except RuntimeError as exc:
        raise OutputError(f"cannot write {second}: {str(exc).splitlines()[-1]}") from exc
    return path, second


def rigid_from_matrix(matrix: Any, target: str, source: str) -> Rigid:
    """A Rigid with the digits of `matrix` kept where it is rigid to full precision, else repaired.

    Raises:
        InvalidInputError: not 4×4 or further than 1e-3 from rigid.
    """
    try:
        array = np.asarray(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as exc:
        raise InvalidInputError(f"the matrix of {target}_from_{source} is not of numbers ({exc})") from exc
    limits.require_lengths(array, f"the matrix of {target}_from_{source}")
    exact = array.shape == (4, 4) and np.isfinite(array).all() and rigidity_defect(array[:3, :3]) <= 1e-9
    if exact and np.array_equal(array[3], (0, 0, 0, 1)):
        return Rigid(target, source, array[:3, :3], array[:3, 3])
    return Rigid.from_matrix(array, target, source)


def _sidecar_frames(path: Path) -> tuple[str, str] | None:
    """Target and source that a sidecar names; None where the JSON beside the transform is something else."""
    document = read_json(path, "a transform sidecar")
    if not isinstance(document, dict) or not {"from", "to"} <= document.keys():
        return None
    return str(document["to"]), str(document["from"])
