"""Read PLUS's settings for finding wires in images: the `<Segmentation>` section of a device set."""

from pathlib import Path
from xml.etree import ElementTree

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.recordings.phantom import WireSearch
from dvf_ig.io.reading import reading

from .xml import numbers, parse_xml


def read_wire_search(device_set_xml: Path | str) -> WireSearch:
    """Read pixel size, clip rectangle, collinearity and number of candidates of `<Segmentation>`.

    Settings of PLUS's own morphology have no counterpart here and are ignored.

    Raises:
        UnreadableFileError: absent, not XML, or a setting that is not a positive number.
    """
    path = Path(device_set_xml)
    with reading(path, "a PLUS device set"):
        section = next(parse_xml(path, "a PLUS device set").iter("Segmentation"), None)
        if section is None:
            return WireSearch()
        candidates = _positive(path, section, "NumberOfMaximumFiducialPointCandidates")
        return WireSearch(
            spacing_mm=_positive(path, section, "ApproximateSpacingMmPerPixel"),
            clip=_clip(path, section),
            candidates=None if candidates is None else round(candidates),
            collinear_mm=_positive(path, section, "CollinearPointsMaxDistanceFromLineMm"),
        )


def _positive(path: Path, section: ElementTree.Element, name: str) -> float | None:
    if name not in section.attrib:
        return None
    value = float(numbers(path, section, name, 1)[0])
    if value <= 0:
        raise UnreadableFileError(f"{path}: {name} of <Segmentation> is {value:g}; it must be positive")
    return value


def _clip(path: Path, section: ElementTree.Element) -> tuple[int, int, int, int] | None:
    """Read first column, first row, columns, rows; None if the section has no clip rectangle."""
    if "ClipRectangleOrigin" not in section.attrib or "ClipRectangleSize" not in section.attrib:
        return None
    left, top = numbers(path, section, "ClipRectangleOrigin", 2).tolist()
    width, height = numbers(path, section, "ClipRectangleSize", 2).tolist()
    return round(left), round(top), round(width), round(height)
