"""Read 3-D and cyclic 4-D images in LPS, mm: MetaImage, NRRD, NIfTI, and folders of DICOM images."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import AnyArray, CycleTiming, FloatArray, InvalidInputError, OutputError, UnreadableFileError
from dvf_ig.core.plausible import SCANNER_MM
from dvf_ig.core.space.rigid import rigidity_defect
from dvf_ig.core.space.volume import Grid, Volume, VolumeSeries
from dvf_ig.io import limits
from dvf_ig.io.dicom.cine import is_dicom_folder, read_dicom_cine
from dvf_ig.io.reading import reading
from dvf_ig.io.writing.atomic import atomic_file

from .header import ImageHeader
from .metaimage import read_metaimage_header
from .nifti import read_nifti_header, read_nifti_voxels
from .nrrd import read_nrrd_header
from .phase_times import require_same_timing
from .timing import read_timing
from .voxels import in_c_order, read_voxels

log = logging.getLogger(__name__)

DIRECTION_TOLERANCE = 1e-3
_EXACT_KEY = "dvf_ig_origin_spacing_direction"
SUFFIXES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")
NIFTI_SUFFIXES = (".nii", ".nii.gz", ".hdr", ".img")


def read_volume(path: Path | str, frame: str = "mr") -> Volume:
    """Read a 3-D image with its pixel type.

    A left-handed grid (common in NIfTI) is turned right-handed by reversing its last axis, which moves no
    voxel in space.

    Args:
        path: NIfTI, NRRD or MetaImage.
        frame: name of the image's LPS frame.
    Raises:
        UnreadableFileError: absent, damaged, not 3-D, not scalar, infinite, or with a sheared grid.
    """
    grid, values = read_array(Path(path), frame, 3)
    return Volume(grid, values)


def read_volume_series(
    path: Path | str, timing: CycleTiming | Path | str | None = None, frame: str = "mr"
) -> VolumeSeries:
    """Read a cyclic 4-D image (x, y, z, phase).

    Args:
        path: NIfTI, NRRD or MetaImage, or a folder of DICOM images (`read_dicom_cine`).
        timing: phase times, or a timing file; None uses the trigger times of DICOM images, else
            `timing.json` in the image's folder, else the times in the image's header, else phase i at i/N
            of an RR of 1.0 s, both marked as assumed.
        frame: name of the image's LPS frame.
    Raises:
        UnreadableFileError: as `read_volume`, not 4-D, or times that contradict `timing.json`.
        InvalidInputError: timing of another number of phases.
    """
    path = Path(path)
    if path.is_dir() or is_dicom_folder(path):
        cine = read_dicom_cine(path, frame, timed=timing is None)
        grid, values = cine.grid, cine.values
        timing = cine.timing if timing is None else timing
    else:
        grid, values = read_array(path, frame, 4)
    if timing is None:
        timing = series_timing(path, len(values))
    elif not isinstance(timing, CycleTiming):
        timing = read_timing(timing, folder=path.parent, phases=len(values), image=path.name)
    if len(timing) != len(values):
        raise InvalidInputError(
            f"{path} has {len(values)} phases, its timing {len(timing)}; they must agree", path=path
        )
    return VolumeSeries(grid, values, timing)


def series_timing(path: Path, phases: int) -> CycleTiming:
    """Read the timing in an image's header or in `timing.json` of its folder; both must agree.

    Raises:
        UnreadableFileError: times of no heart, of another number of phases, or that contradict each other.
    """
    file = path.parent / "timing.json"
    with reading(path, "an image (NIfTI, NRRD or MetaImage)"):
        header = image_header(path)
        try:
            stated = None if header.times is None else header.times.timing(path)
        except InvalidInputError as exc:
            if not file.is_file():
                raise
            log.warning("%s; %s in its folder is used", exc.message, file.name)
            stated = None
        if stated is not None and not file.is_file():
            return stated
        timing = read_timing(None, folder=path.parent, phases=phases, image=path.name)
        if stated is not None:
            require_same_timing(path, stated, file, timing)
        return timing


def image_dimension(path: Path | str) -> int:
    """Return 3 or 4, from the header alone: 3 for a single phase, 4 for a folder of DICOM images.

    Raises:
        UnreadableFileError: absent, not an image, or of another dimension.
    """
    path = Path(path)
    if is_dicom_folder(path):
        return 4
    with reading(path, "an image (NIfTI, NRRD or MetaImage)"):
        count = image_header(path).dimension
        if count not in (3, 4):
            raise UnreadableFileError(
                f"{path} is {count}-D; needed a 3-D image, or 4-D of the phases of a cycle"
            )
        return count


def image_header(path: Path) -> ImageHeader:
    """Parse the header of an image by content and ending.

    Raises:
        UnreadableFileError: damaged, or another format.
    """
    if _is_nifti(path):
        return read_nifti_header(path)
    name = path.name.lower()
    with path.open("rb") as stream:
        begin = stream.read(4)
    if begin == b"NRRD" or name.endswith((".nrrd", ".nhdr")):
        return read_nrrd_header(path)
    if name.endswith((".mha", ".mhd")):
        return read_metaimage_header(path)
    raise UnreadableFileError(
        f"{path} has no known image ending; needed one of {', '.join((*SUFFIXES, *NIFTI_SUFFIXES[2:]))}"
    )


def _is_nifti(path: Path) -> bool:
    return path.name.lower().endswith(NIFTI_SUFFIXES)


def write_volume(volume: Volume, path: Path | str) -> None:
    """Write a 3-D image, compressed; the ending chooses the format.

    Raises:
        OutputError: an unknown ending, a pixel type the format lacks, or not writable.
    """
    _write(_image(volume.grid, volume.values), Path(path))


def write_volume_series(series: VolumeSeries, path: Path | str) -> None:
    """Write a cyclic 4-D image, compressed, without its phase times (see `write_timing`).

    Raises:
        OutputError: as `write_volume`.
    """
    import SimpleITK

    joined = SimpleITK.JoinSeries([_image(series.grid, phase) for phase in series.values])
    joined.SetMetaData(_EXACT_KEY, _exact_text(series.grid))
    _write(joined, Path(path))


def read_array(
    path: Path, frame: str, dimension: int, header: ImageHeader | None = None
) -> tuple[Grid, AnyArray]:
    """Read grid and values, indexed [x, y, z] or [phase, x, y, z], with the phases in order of their times.

    3D Slicer stores sequences and layers of segments as NRRD with a list of values at each voxel; such a list
    is the fourth dimension.

    Args:
        dimension: 3 or 4; a single phase counts as 3-D.
        header: the file's; None parses it.
    Raises:
        UnreadableFileError: as `read_volume`, or of another dimension.
    """
    with reading(path, "an image (NIfTI, NRRD or MetaImage)"):
        header = image_header(path) if header is None else header
        if header.dimension != dimension or header.values_per_voxel != 1:
            raise UnreadableFileError(
                f"{path} is {header.dimension}-D with {header.values_per_voxel} value(s) per voxel; needed "
                f"{dimension}-D with one"
            )
        _require_plausible(path, header.origin_mm, header.spacing_mm)
        values = (read_nifti_voxels if _is_nifti(path) else read_voxels)(path, header)
        if dimension == 3 and header.phase_axis is not None:
            values = values[0]
        elif header.times is not None and not np.array_equal(
            order := header.times.order(path), np.arange(len(values))
        ):
            log.warning("%s: its volumes were put in order of %s", path, header.times.field)
            values = values[order]
        geometry = (header.origin_mm, header.spacing_mm, header.direction)
        return _right_handed(path, frame, *_exact(header.fields.get(_EXACT_KEY, ""), *geometry), values)


def _require_plausible(path: Path, origin: FloatArray, spacing: FloatArray) -> None:
    """Refuse an image farther away than a table or tracker reaches, or voxels that no scanner has."""
    if (far := float(np.abs(origin).max())) > SCANNER_MM:
        raise UnreadableFileError(
            f"{path}: its origin is {far:.3g} mm away; needed at most {SCANNER_MM:g}: check the unit"
        )
    low, high = limits.VOXEL_MM
    if not ((spacing >= low) & (spacing <= high)).all():
        raise UnreadableFileError(
            f"{path}: its voxels have sides of {spacing.tolist()} mm; needed {low:g} to {high:g} mm: "
            "check the unit of its header, which may be m or um"
        )


def _exact(
    text: str, origin: FloatArray, spacing: FloatArray, direction: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Restore the digits that a product of spacing and direction loses, if this program recorded them.

    Recorded digits are used only if they agree with the image's own header.
    """
    try:
        numbers = np.array([float(part) for part in text.split()])
    except ValueError:
        return origin, spacing, direction
    if numbers.size != 15 or not np.allclose(
        numbers, np.concatenate([origin, spacing, direction.ravel()]), rtol=1e-12, atol=1e-9
    ):
        return origin, spacing, direction
    return numbers[:3], numbers[3:6], numbers[6:].reshape(3, 3)


def _right_handed(
    path: Path, frame: str, origin: FloatArray, spacing: FloatArray, direction: FloatArray, values: AnyArray
) -> tuple[Grid, AnyArray]:
    """Build a grid with a proper rotation; the last axis of a left-handed one is reversed."""
    if np.linalg.det(direction) < 0:
        origin = origin + direction[:, 2] * spacing[2] * (values.shape[-1] - 1)
        direction = direction * (1.0, 1.0, -1.0)
        values = values[..., ::-1]
    defect = rigidity_defect(direction)
    if defect > DIRECTION_TOLERANCE:
        raise UnreadableFileError(
            f"{path}: the image axes are sheared (defect {defect:.3g}, needed at most "
            f"{DIRECTION_TOLERANCE:g}); resample it with: antsApplyTransforms -d 3 -i {path.name} "
            f"-r ORTHOGONAL_REFERENCE.nii.gz -o straight_{path.name}"
        )
    _require_finite(path, values)
    shape = (int(values.shape[-3]), int(values.shape[-2]), int(values.shape[-1]))
    owned = in_c_order(values)  # a copy, because `values` may be a view of a temporary image
    owned.setflags(write=False)
    return Grid(frame, shape, origin, spacing, direction), owned


def _require_finite(path: Path, values: AnyArray) -> None:
    """Refuse infinite voxels; NaN in a 3-D image marks what was not imaged.

    Raises:
        UnreadableFileError: a voxel is infinite or beyond GREY_VALUE, or NaN in a cyclic image.
    """
    if values.dtype.kind != "f" or max(abs(values.max()), abs(values.min())) <= limits.GREY_VALUE:
        return
    allowed = np.abs(values) <= limits.GREY_VALUE
    if values.ndim == 3:
        allowed |= np.isnan(values)
    if not allowed.all():
        raise UnreadableFileError(
            f"{path} holds {np.count_nonzero(~allowed)} voxels that are not finite or beyond "
            f"{limits.GREY_VALUE:g}; needed numbers: set them to 0"
        )


def _image(grid: Grid, values: AnyArray) -> Any:
    import SimpleITK

    plain = values.astype(np.uint8) if values.dtype == np.bool_ else values
    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(plain.T))
    image.SetOrigin(grid.origin_mm.tolist())
    image.SetSpacing(grid.spacing_mm.tolist())
    image.SetDirection(grid.direction.ravel().tolist())
    image.SetMetaData(_EXACT_KEY, _exact_text(grid))
    return image


def _exact_text(grid: Grid) -> str:
    numbers = np.concatenate([grid.origin_mm, grid.spacing_mm, grid.direction.ravel()])
    return " ".join(map(repr, numbers.tolist()))


def _write(image: Any, path: Path) -> None:
    import SimpleITK

    if not path.name.lower().endswith(SUFFIXES):
        raise OutputError(f"cannot write {path}: unknown image ending; use one of {', '.join(SUFFIXES)}")
    with atomic_file(path) as temporary:
        try:
            SimpleITK.WriteImage(image, str(temporary), useCompression=True, compressionLevel=1)
        except RuntimeError as exc:
            raise OutputError(f"cannot write {path}: {_itk_reason(exc)}") from exc


def _itk_reason(exc: RuntimeError) -> str:
    """Return the last informative line of ITK's message, without source positions."""
    lines = [line.strip() for line in str(exc).splitlines() if line.strip()]
    return lines[-1].removeprefix("sitk::ERROR: ")[:200] if lines else "no reason given"
