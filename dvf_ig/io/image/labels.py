"""Labels that go with a 4-D image: of its end-diastole alone, or of every phase."""

from pathlib import Path

import numpy as np

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.volume import Grid, Volume, VolumeSeries

from .volume import image_dimension, read_volume, read_volume_series

PLACE_TOLERANCE_MM = 0.05


def read_cine_labels(
    path: Path | str, image: VolumeSeries, ed_phase: int
) -> tuple[Volume, VolumeSeries | None]:
    """Labels of end-diastole, and those of every phase where the file has them.

    Args:
        path: a 3-D label image of end-diastole, or a 4-D one with the image's phases.
        image: the 4-D image that they belong to.
        ed_phase: which phase of it end-diastole is.
    Raises:
        UnreadableFileError: not a readable image.
        InvalidInputError: voxels that do not coincide with the image's, or no such phase.
    """
    path = Path(path)
    if not 0 <= ed_phase < len(image.timing):
        raise InvalidInputError(
            f"end-diastole is phase {ed_phase}; the image has phases 0 to {len(image.timing) - 1}"
        )
    if image_dimension(path) == 3:
        labels = read_volume(path, image.grid.frame)
        _check_place(path, labels.grid, image.grid)
        return Volume(image.grid, labels.values), None
    series = read_volume_series(path, image.timing, image.grid.frame)
    _check_place(path, series.grid, image.grid)
    return Volume(image.grid, series.values[ed_phase]), VolumeSeries(image.grid, series.values, image.timing)


def _check_place(path: Path, labels: Grid, image: Grid) -> None:
    if labels.shape != image.shape:
        raise InvalidInputError(
            f"{path} has {labels.shape} voxels, the 4-D image {image.shape}; draw the labels on a phase of it"
        )
    corners = np.vstack([np.zeros(3), np.diag(np.array(labels.shape) - 1.0)])
    apart = float(np.abs(labels.to_mm(corners) - image.to_mm(corners)).max())
    if apart > PLACE_TOLERANCE_MM:
        raise InvalidInputError(
            f"the voxels of {path} lie up to {apart:.2f} mm from the 4-D image's; needed the same place "
            "(resample the labels onto a phase of it)"
        )
