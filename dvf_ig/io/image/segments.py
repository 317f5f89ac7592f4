"""Read the segments of a 3D Slicer segmentation (`.seg.nrrd`): the layer and value of each."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import AnyArray
from dvf_ig.core.errors import InvalidInputError

from .header import whole_numbers

log = logging.getLogger(__name__)

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

    Source: Slicer's vtkMRMLSegmentationStorageNode, keys Segment<N>_Name, _Layer and _LabelValue.

    Raises:
        UnreadableFileError: a layer or a value that is not a number.
    """
    segments: list[Segment] = []
    while f"Segment{len(segments)}_LabelValue" in fields:
        n = len(segments)
        layer, value = (
            whole_numbers(path, f"Segment{n}_{name}", fields.get(f"Segment{n}_{name}") or "0", 0, MOST_VALUE)
            for name in ("Layer", "LabelValue")
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
        out[inside] = value
    if values != tuple(segment.value for segment in segments):
        numbers = ", ".join(f"{v} {s.name}" for v, s in zip(values, segments, strict=True))
        log.warning("%s: segments share a value, so they are numbered: %s", path, numbers)
    return out
