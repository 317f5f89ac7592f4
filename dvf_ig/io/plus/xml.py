"""Read and write PLUS configuration XML and its `<CoordinateDefinitions>` of calibrated transforms."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from dvf_ig.core import RAS_FROM_LPS, Rigid, UnreadableFileError, read_only_arrays
from dvf_ig.core.arrays import FloatArray, frozen_floats
from dvf_ig.io.provenance import MARKUP_COMMENT
from dvf_ig.io.reading import read_bytes, reading
from dvf_ig.io.writing.atomic import write_bytes

from .names import frame_from_plus, frame_to_plus

LARGEST = 1e9
"""Largest coordinate, pixel or index of a calibration."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CoordinateDefinition:
    """One transform of a PLUS configuration.

    Attributes:
        target, source: frame names.
        matrix: (4, 4) target_from_source in mm (mm per pixel if a frame is an image).
        error_mm: calibration error recorded with it, or None.
        date: as recorded, or None.
    """

    target: str
    source: str
    matrix: FloatArray
    error_mm: float | None = None
    date: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", frozen_floats(self.matrix, f"matrix of {self.name}", (4, 4)))

    @property
    def name(self) -> str:
        return f"{self.target}_from_{self.source}"


def parse_xml(path: Path, what: str) -> ElementTree.Element:
    """Parse an XML file to its root element, or raise UnreadableFileError with the line."""
    data = read_bytes(path, what)
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, LookupError, ValueError) as exc:
        raise UnreadableFileError(f"{path} is not {what}: {exc}") from exc


def numbers(path: Path, element: ElementTree.Element, attribute: str, count: int) -> FloatArray:
    """Parse (count,) finite numbers of an attribute, or raise UnreadableFileError."""
    text = element.attrib.get(attribute)
    try:
        values = np.array((text or "").split(), dtype=np.float64)
    except ValueError:
        values = np.zeros(0)
    if values.size != count or not (np.abs(values) <= LARGEST).all():
        shown = "absent" if text is None else f"'{' '.join(text.split())[:60]}'"
        raise UnreadableFileError(
            f"{path}: {attribute} of <{element.tag}> is {shown}; needed {count} finite numbers up to 1e9"
        )
    return values


def _matrix(path: Path, element: ElementTree.Element) -> FloatArray:
    """Parse a (4, 4) matrix, row by row."""
    matrix = numbers(path, element, "Matrix", 16).reshape(4, 4)
    if (np.abs(matrix[3] - (0, 0, 0, 1)) > 1e-9).any():
        raise UnreadableFileError(
            f"{path}: Matrix of <{element.tag}> has the last row {matrix[3].tolist()}; needed 0 0 0 1: write "
            "it row by row"
        )
    return matrix


def read_calibrations(path: Path | str) -> dict[str, CoordinateDefinition]:
    """Read every transform of `<CoordinateDefinitions>` by its name, such as "reference_from_phantom".

    Raises:
        UnreadableFileError: absent, not XML, no such section, or a matrix that is not 16 numbers.
    """
    path = Path(path)
    with reading(path, "a PLUS configuration"):
        root = parse_xml(path, "a PLUS configuration")
        section = root if root.tag == "CoordinateDefinitions" else root.find(".//CoordinateDefinitions")
        if section is None:
            raise UnreadableFileError(f"{path} has no <CoordinateDefinitions>; give a PLUS device-set file")
        return read_transforms(path, section)


def read_transforms(path: Path, section: ElementTree.Element) -> dict[str, CoordinateDefinition]:
    """Read every `<Transform From To Matrix>` below an element by its name; `path` is for messages."""
    elements = [e for e in section.iter("Transform") if {"From", "To", "Matrix"} & e.attrib.keys()]
    definitions: dict[str, CoordinateDefinition] = {}
    for definition in (_definition(path, element) for element in elements):
        first = definitions.setdefault(definition.name, definition)
        if not np.array_equal(first.matrix, definition.matrix):
            raise UnreadableFileError(
                f"{path} holds {definition.name} twice, with different matrices; keep the one that is true"
            )
    return definitions


def read_coordinate_definitions(path: Path | str) -> dict[str, FloatArray]:
    """Read (4, 4) matrices of `<CoordinateDefinitions>` by name, without error and date."""
    return {name: definition.matrix for name, definition in read_calibrations(path).items()}


def write_coordinate_definitions(
    path: Path | str, definitions: Mapping[str, FloatArray] | list[CoordinateDefinition]
) -> None:
    """Write transforms as a PLUS configuration; matrices read back to the same float64 values.

    Args:
        path: the XML file.
        definitions: matrices by "target_from_source", or values that carry error and date.
    Raises:
        InvalidInputError: a name that is not target_from_source, or not valid in PLUS.
        OutputError: not writable.
    """
    if not isinstance(definitions, list):
        pairs = [(name.partition("_from_"), matrix) for name, matrix in definitions.items()]
        definitions = [CoordinateDefinition(split[0], split[2], matrix) for split, matrix in pairs]
    root = ElementTree.Element("PlusConfiguration", version="2.1")
    root.append(definitions_element(definitions))
    write_xml(Path(path), root)


def write_registration(rigid: Rigid, path: Path | str, error_mm: float | None = None) -> Path:
    """Write mr_from_tracker for a PLUS configuration: TrackerToMr, and MrToRas.

    Its source frame must have PLUS's name: "reference" if poses were relative to that marker.

    `Mr` is LPS. PLUS and 3D Slicer exchange RAS: MrToRas lets PLUS answer with TrackerToRas, and shows that
    Mr itself is not RAS.

    Returns:
        the file.
    Raises:
        OutputError: an existing user file is in the way, or not writable.
    """
    path = Path(path)
    pose = CoordinateDefinition(rigid.target, rigid.source, rigid.matrix, error_mm)
    flip = CoordinateDefinition("ras", rigid.target, RAS_FROM_LPS)
    write_coordinate_definitions(path, [pose, flip])
    return path


def definitions_element(definitions: list[CoordinateDefinition]) -> ElementTree.Element:
    """Build the `<CoordinateDefinitions>` element."""
    section = ElementTree.Element("CoordinateDefinitions")
    for definition in definitions:
        rows = "\n".join("        " + " ".join(map(repr, row)) for row in definition.matrix.tolist())
        element = ElementTree.SubElement(
            section,
            "Transform",
            From=frame_to_plus(definition.source),
            To=frame_to_plus(definition.target),
            Matrix=f"\n{rows}",
        )
        if definition.error_mm is not None:
            element.set("Error", repr(float(definition.error_mm)))
        if definition.date is not None:
            element.set("Date", definition.date)
    return section


def write_xml(path: Path, root: ElementTree.Element) -> None:
    """Write an element as an indented XML file with our mark, atomically."""
    root.insert(0, ElementTree.Comment(MARKUP_COMMENT))
    ElementTree.indent(root)
    write_bytes(path, [ElementTree.tostring(root, encoding="utf-8", xml_declaration=True), b"\n"])


def _definition(path: Path, element: ElementTree.Element) -> CoordinateDefinition:
    names = (element.attrib.get("To"), element.attrib.get("From"))
    if not names[0] or not names[1]:
        raise UnreadableFileError(f"{path}: a <Transform> lacks From or To")
    error = None if "Error" not in element.attrib else float(numbers(path, element, "Error", 1)[0])
    return CoordinateDefinition(
        frame_from_plus(names[0]),
        frame_from_plus(names[1]),
        _matrix(path, element),
        error,
        element.attrib.get("Date"),
    )
