"""Read labels of a 4-D image: of end-diastole alone, or of every phase."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import AnyArray, FloatArray
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.plausible import LABELS_MM
from dvf_ig.core.space.volume import Grid, Volume, VolumeSeries
from dvf_ig.io.reading import reading

from .segments import merged_segments, segment_values, segments_of
from .volume import image_header, read_array

log = logging.getLogger(__name__)

PLACE_TOLERANCE_MM = 0.05


def read_cine_labels(
    path: Path | str, image: VolumeSeries, ed_phase: int
) -> tuple[Volume, VolumeSeries | None]:
    """Read labels of end-diastole, and those of every phase if the file has them.

    Args:
        path: a 3-D label image of end-diastole, a segmentation of 3D Slicer (`.seg.nrrd`), or a 4-D image
            with one phase or all phases of the image. It may be cropped, and its axes may be permuted or
            reversed, as long as its voxels coincide with voxels of the image.
        image: the 4-D image that they belong to.
        ed_phase: which phase of it end-diastole is.
    Raises:
        UnreadableFileError: not a readable image.
        InvalidInputError: voxels that do not coincide with the image's, segments that overlap, another number
            of phases, or no such phase.
    """
    path = Path(path)
    phases = len(image.timing)
    if not 0 <= ed_phase < phases:
        raise InvalidInputError(f"end-diastole is phase {ed_phase}; the image has phases 0 to {phases - 1}")
    grid, layers = _read(path, image.grid.frame)
    if len(layers) not in (1, phases):
        raise InvalidInputError(
            f"{path} has labels of {len(layers)} phases, the image has {phases}; needed those of "
            "end-diastole or of every phase"
        )
    _require_organ_size(path, grid, layers)
    placed = _on_grid(path, grid, layers, image.grid)
    if len(placed) == 1:
        return Volume(image.grid, placed[0]), None
    return Volume(image.grid, placed[ed_phase]), VolumeSeries(image.grid, placed, image.timing)


def read_labels(path: Path | str, frame: str = "mr") -> tuple[Volume, ...]:
    """Read a label image: one volume of a 3-D image or 3D Slicer segmentation, one per phase of a 4-D image.

    Raises:
        UnreadableFileError: not a readable image.
        InvalidInputError: segments that overlap.
    """
    grid, layers = _read(Path(path), frame)
    return tuple(Volume(grid, values) for values in layers)


def read_label_names(path: Path | str) -> tuple[tuple[int, str], ...]:
    """Read label and name of each segment of a 3D Slicer segmentation; empty for any other image."""
    path = Path(path)
    with reading(path, "a label image"):
        segments = segments_of(path, image_header(path).fields)
    return tuple(zip(segment_values(segments), (s.name for s in segments), strict=True))


def _read(path: Path, frame: str) -> tuple[Grid, AnyArray]:
    """Read the grid and (phases, x, y, z) labels."""
    with reading(path, "a label image"):
        header = image_header(path)
        if len(header.sizes) == 4 and header.sizes[0] == 1 and header.phase_axis == 3:
            log.warning("%s: its first axis has one voxel; the other three are taken as x, y, z", path)
            header = replace(header, sizes=header.sizes[1:], phase_axis=None, times=None)
        if header.dimension not in (3, 4):
            raise UnreadableFileError(f"{path} is {header.dimension}-D; needed labels of 3-D or 4-D")
        grid, values = read_array(path, frame, header.dimension, header)
        layers = values[None] if header.dimension == 3 else values
        if layers.dtype.kind == "f" and (layers != np.rint(layers)).any():
            odd = layers[layers != np.rint(layers)][0]
            raise UnreadableFileError(
                f"{path} holds {odd:g}; needed labels, which are whole numbers: resample by nearest "
                "neighbour, or threshold probabilities"
            )
        if (least := layers.min()) < 0:
            raise UnreadableFileError(f"{path} holds {least:g}; needed labels, 0 or more: set it to 0")
        segments = segments_of(path, header.fields)
        return grid, merged_segments(path, layers, segments)[None] if segments else layers


def _require_organ_size(path: Path, grid: Grid, layers: AnyArray) -> None:
    """Refuse labels of a size that no organ has, as voxels in cm or m give."""
    inside = (layers != 0).any(axis=0)
    if not inside.any():
        return  # who chooses labels reports which are present
    ends = [np.flatnonzero(np.moveaxis(inside, axis, 0).any(axis=(1, 2)))[[0, -1]] for axis in range(3)]
    side = max(float((last - first + 1) * grid.spacing_mm[axis]) for axis, (first, last) in enumerate(ends))
    low, high = LABELS_MM
    if not low <= side <= high:
        raise InvalidInputError(
            f"{path}: its labels are {side:.3g} mm across, and an organ {low:g} to {high:g} mm; correct the "
            "voxel size (mm) of the image and its labels"
        )


def _on_grid(path: Path, labels: Grid, values: AnyArray, image: Grid) -> AnyArray:
    """Place labels on the image's grid as (phases, x, y, z); 0 outside a crop."""
    turn = np.rint(np.linalg.solve(image.axes_mm, labels.axes_mm))
    if not (np.abs(turn).sum(axis=0) == 1).all() or not (np.abs(turn).sum(axis=1) == 1).all():
        raise InvalidInputError(
            f"the voxels of {path} have another size or direction than the 4-D image's; needed the same "
            "(resample the labels onto a phase of it)"
        )
    first = np.rint(image.to_index(labels.origin_mm))
    ends = np.array(labels.shape) - 1.0
    corners: FloatArray = np.vstack([np.zeros(3), np.diag(ends), ends])
    index = corners @ turn.T + first
    apart = float(np.abs(labels.to_mm(corners) - image.to_mm(index)).max())
    if apart > PLACE_TOLERANCE_MM:
        raise InvalidInputError(
            f"the voxels of {path} lie up to {apart:.2f} mm from the 4-D image's; needed the same positions "
            "(resample the labels onto a phase of it)"
        )
    low, high = index.min(axis=0).astype(int), index.max(axis=0).astype(int) + 1
    if (low < 0).any() or (high > image.shape).any():
        raise InvalidInputError(
            f"{path} reaches beyond the 4-D image by up to {max(-low.min(), (high - image.shape).max())} "
            "voxels; crop the labels to it"
        )
    source = np.abs(turn).argmax(axis=1)  # the label axis along each image axis
    turned = values.transpose(0, *(source + 1))
    turned = turned[(slice(None), *(slice(None, None, int(turn[a, source[a]])) for a in range(3)))]
    out = np.zeros((len(values), *image.shape), values.dtype)
    out[(slice(None), *(slice(int(a), int(b)) for a, b in zip(low, high, strict=True)))] = turned
    return out
