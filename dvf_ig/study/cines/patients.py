"""Cines with an expert's labels at end-diastole and end-systole, as folders hold them."""

from dataclasses import dataclass
from pathlib import Path

from dvf_ig.core import InvalidInputError, UnreadableFileError, Volume, VolumeSeries
from dvf_ig.io import read_json, read_labels, read_volume_series
from dvf_ig.preop import axis_of_lost_spacing, with_voxel_size

CINE, ED, ES, FRAMES = "cine_4d.nii.gz", "ed_labels.nii.gz", "es_labels.nii.gz", "frames.json"


@dataclass(frozen=True, slots=True, eq=False)
class LabelledCine:
    """One patient.

    Attributes:
        name: of the folder.
        image: all frames.
        ed, es: the expert's labels.
        ed_phase, es_phase: the frames that they belong to, counted from 0.
        spacing_given: the header had lost the voxel size; it was given.
    """

    name: str
    image: VolumeSeries
    ed: Volume
    es: Volume
    ed_phase: int
    es_phase: int
    spacing_given: bool


def labelled_cines(folder: Path, names: tuple[str, ...] = ()) -> tuple[Path, ...]:
    """Folders of patients, in order of their names.

    Args:
        names: only folders whose name ends with one of these; none means all.
    Raises:
        InvalidInputError: there is none.
    """
    found = sorted(path.parent for path in folder.glob(f"*/{CINE}"))
    chosen = tuple(path for path in found if not names or path.name.endswith(names))
    if not chosen:
        raise InvalidInputError(
            f"{folder} has no patient's folder {' or '.join(names)} with {CINE}, {ED}, {ES} and {FRAMES}"
        )
    return chosen


def read_labelled_cine(folder: Path, voxel_mm: tuple[float, float, float] | None = None) -> LabelledCine:
    """One patient's cine and labels.

    Args:
        voxel_mm: voxel size of cines whose header has lost it; others keep theirs.
    Raises:
        UnreadableFileError: a file is missing or is not what it should be.
        InvalidInputError: the header has lost the voxel size and none is given, or grids that do not agree.
    """
    image = read_volume_series(folder / CINE)
    (ed,), (es,) = read_labels(folder / ED), read_labels(folder / ES)
    frames = read_json(folder / FRAMES, "the numbers of the labelled frames")
    try:
        first = int(frames["first_frame"])
        ed_phase, es_phase = int(frames["ed_frame"]) - first, int(frames["es_frame"]) - first
    except (TypeError, ValueError, KeyError) as exc:
        raise UnreadableFileError(
            f"cannot read {folder / FRAMES}; needed ed_frame, es_frame and first_frame"
        ) from exc
    if not ed.grid.shape == es.grid.shape == image.grid.shape:
        raise InvalidInputError(f"labels and cine of {folder} have voxels of different numbers")
    if not (0 <= ed_phase < len(image.timing) and 0 <= es_phase < len(image.timing)):
        raise InvalidInputError(f"{folder / FRAMES} names frames that the cine does not have")
    lost = axis_of_lost_spacing(image.values[ed_phase], image.grid.spacing_mm) is not None
    grid = image.grid
    if lost:
        if voxel_mm is None:
            raise InvalidInputError(
                f"the header of {folder / CINE} has lost its voxel size (it says "
                f"{', '.join(f'{s:g}' for s in grid.spacing_mm)} mm); give it, as in "
                "--voxel-mm 1.5,1.5,10"
            )
        grid = with_voxel_size(grid, voxel_mm)
    return LabelledCine(
        folder.name,
        VolumeSeries(grid, image.values, image.timing),
        Volume(grid, ed.values),
        Volume(grid, es.values),
        ed_phase,
        es_phase,
        lost,
    )
