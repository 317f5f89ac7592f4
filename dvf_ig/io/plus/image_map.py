"""Read image calibrations from PLUS files: ImageToProbe matrices that are not exactly rigid times scale."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.plausible import pixel_problem
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.io.reading import reading

from .xml import CoordinateDefinition, parse_xml, read_transforms

SAME_MM = 0.1
"""Largest distance, at the corners of a square of CORNER_PX, of two ways from the image to the sensor."""
CORNER_PX = 500.0


def read_image_map(path: Path | str, sensor: str = "probe") -> ImageMap:
    """Read probe_from_image of a PLUS configuration or probe-calibration result.

    PLUS fits each column separately: the first two are made orthogonal, the third, of arbitrary length in
    PLUS's files, is rebuilt. The result's `shear_deg` states how far they were from orthogonal.

    Args:
        path: PLUS XML with `<Transform From="Image" To="Probe">`, or with a chain of transforms between them.
        sensor: name of the sensor's frame.
    Raises:
        UnreadableFileError: absent, not XML, no such transform, two ways from the image to the sensor that
            disagree, or image axes more than 1° off orthogonal.
    """
    path = Path(path)
    name = f"{sensor}_from_image"
    with reading(path, "a PLUS image calibration"):
        transforms = read_transforms(path, parse_xml(path, "a PLUS image calibration"))
        ways = dict(_ways(transforms, "image", sensor, np.eye(4), ("image",)))
        if not ways:
            raise UnreadableFileError(
                f"{path} has no transform {name}; it has {', '.join(sorted(transforms)) or 'none'}: give "
                "the file that holds it, or name its sensor",
                settings=("ultrasound.probe_name",),
            )
        chosen = min(ways, key=len)
        corners = np.array([[0, CORNER_PX, 0, CORNER_PX], [0, 0, CORNER_PX, CORNER_PX], [0] * 4, [1] * 4])
        for way, matrix in ways.items():
            apart = np.linalg.norm(((matrix - ways[chosen]) @ corners)[:3], axis=0).max()
            if apart > SAME_MM:
                raise UnreadableFileError(
                    f"{path}: the transforms {' to '.join(way)} and {' to '.join(chosen)} place the image "
                    f"{apart:.3g} mm apart; keep the ones that are true"
                )
        placed = ImageMap.from_matrix(ways[chosen], sensor)
        if problem := pixel_problem(placed.scale_mm_per_px):
            raise InvalidInputError(problem)
        return placed


def _ways(
    transforms: Mapping[str, CoordinateDefinition],
    at: str,
    to: str,
    before: FloatArray,
    passed: tuple[str, ...],
) -> Iterator[tuple[tuple[str, ...], FloatArray]]:
    """Yield every way from a frame to another: the frames that it passes, and its (4, 4) matrix."""
    if at == to:
        yield passed, before
        return
    for one in transforms.values():
        for source, target, forward in ((one.source, one.target, True), (one.target, one.source, False)):
            if source == at and target not in passed:
                if not forward and abs(np.linalg.det(one.matrix)) < 1e-12:
                    continue
                step = one.matrix if forward else np.linalg.inv(one.matrix)
                yield from _ways(transforms, target, to, step @ before, (*passed, target))
