"""Read the segments of a 3D Slicer segmentation (`.seg.nrrd`): the layer and value of each."""

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import AnyArray
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError

from .header import whole_numbers

log = logging.getLogger(__name__)

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
                f"{path}: segment '{segment.name}' is in layer {segment.layer}, not stored",
                path=path,
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
                "%s: %d voxels of layer %d have a value of no segment, and are left out",
                path,
                unnamed,
                number,
            )
