"""Read and write rigid transforms as ITK files with a JSON sidecar that states their frames."""

from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, FrameMismatchError, InvalidInputError, OutputError
from dvf_ig.core.space.rigid import Rigid, rigidity_defect

from . import limits
from .itk_transform import linear_matrix
from .json_file import read_json, write_sidecar
from .reading import reading, refuse_lfs_pointer
from .writing.atomic import atomic_file, write_text
from .writing.listing import require_outputs

CONVENTION = "ITK: maps points of 'from' (fixed image) to 'to' (moving image); LPS, mm"


def read_transform(path: Path | str, target: str | None = None, source: str | None = None) -> Rigid:
    """Read target_from_source from an ITK transform file (`.tfm`, `.txt`, `.h5`, `.mat`).

    Direction: an ITK transform maps points of the *fixed* image to the *moving* image, both LPS in mm, as
    resampling filters need it. Here fixed is the source frame and moving the target frame, so the
    matrix in the file is target_from_source itself, p_target = A (p_source − c) + t + c. (3D Slicer shows
    the inverse, because its "transform to parent" runs from moving to fixed, in RAS.)

    Args:
        path: the transform; its frames are read from the sidecar `<stem>.json` in the same folder.
        target, source: needed without a sidecar; with one they must agree with it.
    Raises:
        UnreadableFileError: absent, not a linear ITK transform, or not rigid.
        FrameMismatchError: the sidecar names other frames.
        InvalidInputError: no sidecar and no frames given.
    """
    path = Path(path)
    refuse_lfs_pointer(path)
    sidecar, recorded = path.with_suffix(".json"), sidecar_frames(path)
    if recorded is not None:
        recorded_target, recorded_source = recorded
        frames = (target or recorded_target, source or recorded_source)
        if frames != (recorded_target, recorded_source):
            raise FrameMismatchError(
                f"{path} is {recorded_target}_from_{recorded_source}; needed {frames[0]}_from_{frames[1]}: "
                f"invert it, or correct the names in {sidecar.name}"
            )
        target, source = frames
    elif path.is_file() and (target is None or source is None):
        raise InvalidInputError(
            f"{path}: its frames are unknown; add a file {sidecar.name} to its folder with "
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
    """Format a (4, 4) affine matrix as an ITK transform, with every digit."""
    numbers = " ".join(map(repr, [*matrix[:3, :3].ravel().tolist(), *matrix[:3, 3].tolist()]))
    return (
        "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\n"
        f"Parameters: {numbers}\nFixedParameters: 0 0 0\n"
    )


def write_transforms(rigid: Rigid, path: Path | str, error_mm: float | None = None) -> tuple[Path, Path]:
    """Write target_from_source as `.tfm` and as `.h5`, the format that 3D Slicer itself saves.

    Returns:
        The two files; one sidecar `<stem>.json` belongs to both.
    Raises:
        OutputError: as `write_transform`, or an existing user file is in the way.
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
    """Build a Rigid with the digits of `matrix` if it is rigid to full precision, else repaired.

    Raises:
        InvalidInputError: not 4×4 or further than 1e-3 from rigid.
    """
    try:
        array = np.asarray(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as exc:
        raise InvalidInputError(
            f"the matrix of {target}_from_{source} does not hold numbers ({exc})"
        ) from exc
    limits.require_lengths(array, f"the matrix of {target}_from_{source}")
    exact = array.shape == (4, 4) and np.isfinite(array).all() and rigidity_defect(array[:3, :3]) <= 1e-9
    if exact and np.array_equal(array[3], (0, 0, 0, 1)):
        return Rigid(target, source, array[:3, :3], array[:3, 3])
    return Rigid.from_matrix(array, target, source)


def sidecar_frames(path: Path) -> tuple[str, str] | None:
    """Read target and source of a transform from its sidecar; None without one."""
    sidecar = path.with_suffix(".json")
    if sidecar == path or not sidecar.is_file():
        return None
    document = read_json(sidecar, "a transform sidecar")
    if not isinstance(document, dict) or not {"from", "to"} <= document.keys():
        return None
    return str(document["to"]), str(document["from"])
