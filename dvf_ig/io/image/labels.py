"""Read labels of a 4-D image, of end-diastole alone or of every phase, and segments of 3D Slicer."""

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dvf_ig.core import AnyArray, FloatArray, InvalidInputError, UnreadableFileError
from dvf_ig.core.plausible import LABELS_MM
from dvf_ig.core.space.volume import Grid, Volume, VolumeSeries
from dvf_ig.io.reading import reading

from .header import whole_numbers
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


_SEGMENT = re.compile(r"Segment(\d{1,5})_(?:ID|LabelValue)")
_STORED_AS = ("Master", "Source")
"""Names of the representation that a file holds, in Slicer 4 and 5."""
MOST_VALUE = (1 << 16) - 1
"""Largest label value."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A segment's name, layer (overlapping segments are in different layers) and value in that layer."""

    name: str
    layer: int
    value: int


def segments_of(path: Path, fields: Mapping[str, str]) -> tuple[Segment, ...]:
    """List the segments in an image's header; empty if it is not a 3D Slicer segmentation.

    Source: Slicer's vtkMRMLSegmentationStorageNode, keys Segment<N>_Name, _Layer and _LabelValue; files of
    Slicer 4.10 and before have the last two not, and one layer per segment.

    Raises:
        UnreadableFileError: a layer or a value that is not a number, or segments that are not binary.
    """
    if any("fractional" in fields.get(f"Segmentation_{key}Representation", "").lower() for key in _STORED_AS):
        raise UnreadableFileError(
            f"{path} holds a fractional segmentation; needed binary labels: threshold it in 3D Slicer, and "
            "save it again"
        )
    numbers = {int(match[1]) for name in fields if (match := _SEGMENT.fullmatch(name))}
    segments: list[Segment] = []
    for order, n in enumerate(sorted(numbers)):
        stated = f"Segment{n}_LabelValue" in fields
        default = {"Layer": "0" if stated else str(order), "LabelValue": "1"}
        texts = {f"Segment{n}_{name}": other for name, other in default.items()}
        layer, value = (
            whole_numbers(path, name, fields.get(name) or other, 0, MOST_VALUE)
            for name, other in texts.items()
        )
        segments.append(Segment(fields.get(f"Segment{n}_Name") or f"segment {n}", layer[0], value[0]))
    return tuple(segments)


def segment_values(segments: tuple[Segment, ...]) -> tuple[int, ...]:
    """Assign each segment its label in a merged image: its own value, or n + 1 if two values are equal."""
    values = tuple(segment.value for segment in segments)
    return values if len(set(values)) == len(values) else tuple(range(1, len(segments) + 1))


def merged_segments(path: Path, layers: AnyArray, segments: tuple[Segment, ...]) -> AnyArray:
    """Merge all segments into one (x, y, z) label image, with their own values if these differ.

    If two segments share a value in different layers, segment n gets n + 1; the numbers are logged.

    Args:
        layers: (layers, x, y, z).
    Raises:
        InvalidInputError: segments that overlap, or a layer that is not in the file.
    """
    values = segment_values(segments)
    out = np.zeros(layers.shape[1:], np.uint16)
    for value, segment in zip(values, segments, strict=True):
        if not 0 <= segment.layer < len(layers):
            raise InvalidInputError(
                f"{path}: segment '{segment.name}' is in layer {segment.layer}, not stored", path=path
            )
        inside = layers[segment.layer] == segment.value
        if out[inside].any():
            raise InvalidInputError(
                f"{path}: segment '{segment.name}' overlaps another; save them without overlap (Segment "
                "Editor, Modify other segments: overwrite all)",
                path=path,
            )
        if not inside.any():
            log.warning("%s: segment '%s' is empty", path, segment.name)
        out[inside] = value
    _warn_of_unnamed(path, layers, segments)
    if values != tuple(segment.value for segment in segments):
        numbers = ", ".join(f"{v} {s.name}" for v, s in zip(values, segments, strict=True))
        log.warning("%s: segments share a value, so they are numbered: %s", path, numbers)
    return out


def _warn_of_unnamed(path: Path, layers: AnyArray, segments: tuple[Segment, ...]) -> None:
    """Log voxels that belong to no segment of the header."""
    for number, layer in enumerate(layers):
        named = [0, *(segment.value for segment in segments if segment.layer == number)]
        if unnamed := np.count_nonzero(~np.isin(layer, named)):
            log.warning(
                f"{path}: {unnamed} voxels of layer {number} have a value of no segment, and are left out"
            )
