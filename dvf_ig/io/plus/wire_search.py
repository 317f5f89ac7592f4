"""How PLUS's device set says wires are to be sought in images: its `<Segmentation>` section."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io.reading import reading

from .xml import numbers, parse_xml

if TYPE_CHECKING:
    from dvf_ig.calibration.wires.images import WireImageOptions


def read_wire_search(device_set_xml: Path | str) -> "WireImageOptions":
    """Pixel size, clip rectangle, collinearity and number of candidates of a device set's `<Segmentation>`.

    What it does not say keeps its default: without an approximate spacing the pixel size is estimated.
    Settings of PLUS's own morphology have no counterpart here and are left alone.

    Raises:
        UnreadableFileError: absent, not XML, or a setting that is not a positive number.
    """
    from dvf_ig.calibration.wires.images import WireImageOptions

    path = Path(device_set_xml)
    with reading(path, "a PLUS device set"):
        section = next(parse_xml(path, "a PLUS device set").iter("Segmentation"), None)
        options = WireImageOptions()
        if section is None:
            return options
        most = _positive(path, section, "NumberOfMaximumFiducialPointCandidates")
        collinear_mm = _positive(path, section, "CollinearPointsMaxDistanceFromLineMm")
        dots, pattern = options.dots, options.pattern
        if most is not None:
            # more cost little, and a bright wall can take many places
            dots = replace(dots, most=max(dots.most, round(most)))
        if collinear_mm is not None:
            pattern = replace(pattern, lines=replace(pattern.lines, collinear_mm=collinear_mm))
        return WireImageOptions(
            spacing_mm=_positive(path, section, "ApproximateSpacingMmPerPixel"),
            clip=_clip(path, section),
            dots=dots,
            pattern=pattern,
        )


def _positive(path: Path, section: ElementTree.Element, name: str) -> float | None:
    if name not in section.attrib:
        return None
    value = float(numbers(path, section, name, 1)[0])
    if value <= 0:
        raise UnreadableFileError(f"{path}: {name} of <Segmentation> is {value:g}; it must be positive")
    return value


def _clip(path: Path, section: ElementTree.Element) -> tuple[int, int, int, int] | None:
    """First column, first row, columns, rows; None where the section has no clip rectangle."""
    if "ClipRectangleOrigin" not in section.attrib or "ClipRectangleSize" not in section.attrib:
        return None
    left, top = numbers(path, section, "ClipRectangleOrigin", 2).tolist()
    width, height = numbers(path, section, "ClipRectangleSize", 2).tolist()
    return round(left), round(top), round(width), round(height)
