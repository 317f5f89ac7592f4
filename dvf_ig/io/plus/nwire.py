"""Read and write N-wire calibration of PLUS: phantom and its landmarks, segmentation, wires, poses."""

import re
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, PoseStream, Rigid, TrackedSequence, UnreadableFileError
from dvf_ig.core.plausible import phantom_problem
from dvf_ig.core.recordings.phantom import NWirePhantom, NWireRecording, Wire, WireSearch
from dvf_ig.core.space.points import Landmarks, Points
from dvf_ig.io import limits
from dvf_ig.io.reading import reading
from dvf_ig.io.transform import rigid_from_matrix

from .names import USUAL_NAMES, ProbeNames, frame_to_plus
from .sequence_read import read_indexed_sequence
from .xml import CoordinateDefinition, definitions_element, numbers, parse_xml, read_calibrations, write_xml

Section = Literal["CalibrationData", "ValidationData"]


def read_nwire_phantom(device_set_xml: Path | str) -> NWirePhantom:
    """Read the N patterns of a PLUS device set's `<PhantomDefinition>`.

    Raises:
        UnreadableFileError: absent, not XML, no NWire pattern, or a pattern without exactly three wires.
    """
    path = Path(device_set_xml)
    with reading(path, "a PLUS device set"):
        root = parse_xml(path, "a PLUS device set")
        patterns = [p for p in root.iter("Pattern") if p.attrib.get("Type") == "NWire"]
        if not patterns:
            raise UnreadableFileError(
                f"{path} defines no NWire pattern; give the device set with the phantom"
            )
        phantom = NWirePhantom(tuple(_pattern(path, pattern) for pattern in patterns))
        if problem := phantom_problem([end for w in phantom.wires for end in (w.front_mm, w.back_mm)]):
            raise InvalidInputError(f"its phantom {problem}")
        return phantom


def read_wire_points(
    xml: Path | str, section: Section, phantom: NWirePhantom, frames: int | None = None
) -> FloatArray:
    """Read segmented wire crossings from one section of a PLUS calibration result.

    Args:
        xml: file with `<CalibrationData>` and `<ValidationData>`.
        section: the one to read.
        phantom: gives the wires and their order.
        frames: frames in the recording; None uses the highest frame index + 1.
    Returns:
        (frames, wires, 2) column, row in px; NaN if a frame or a wire was not segmented.
    Raises:
        UnreadableFileError: absent, no such section, an unknown wire, or a frame beyond the recording.
    """
    path = Path(xml)
    with reading(path, "segmented wire points"):
        part = next(parse_xml(path, "segmented wire points").iter(section), None)
        if part is None:
            raise UnreadableFileError(f"{path} has no <{section}>; give a PLUS calibration result")
        elements = [(_index(path, e), e) for e in part.findall("Frame")]
        if len({index for index, _ in elements}) < len(elements):
            raise UnreadableFileError(f"{path}: <{section}> lists a frame twice; needed one entry per frame")
        count = max((i for i, _ in elements), default=-1) + 1 if frames is None else frames
        limits.require_count(count, limits.FRAMES, "frames")
        order = {wire.name: w for w, wire in enumerate(phantom.wires)}
        points = np.full((count, len(order), 2), np.nan)
        for index, element in elements:
            if index >= count:
                raise UnreadableFileError(
                    f"{path}: <{section}> has frame {index}, the recording has {count} frames"
                )
            if element.attrib.get("SegmentationStatus", "OK").upper() != "OK":
                continue
            for point in element.findall("SegmentedPoints/Point"):
                name = point.attrib.get("WireName", "")
                if name in order and not np.isnan(points[index, order[name]]).any():
                    raise UnreadableFileError(f"{path}: frame {index} has wire '{name}' twice; keep one")
                if name not in order:
                    raise UnreadableFileError(
                        f"{path}: wire '{name}' is not in the phantom ({', '.join(order)})"
                    )
                points[index, order[name]] = numbers(path, point, "Position", 3)[:2]
        return points


def read_nwire_recording(
    sequence_path: Path | str,
    device_set_xml: Path | str,
    points_xml: Path | str,
    section: Section,
    names: ProbeNames = USUAL_NAMES,
) -> NWireRecording:
    """Read phantom, probe poses relative to it and wire crossings, matched frame by frame.

    Args:
        sequence_path: PLUS sequence with the probe tracked against the reference (or tracker).
        device_set_xml: phantom geometry and pose: Phantom to Reference (or Tracker).
        points_xml: segmented points; their frame index counts the frames of the sequence file.
        section: section of that file.
        names: of probe and reference, see `phantom_from_probe`.
    Raises:
        UnreadableFileError: one of the three cannot be read or is incomplete.
    """
    phantom = read_nwire_phantom(device_set_xml)
    sequence, indices, frames = read_indexed_sequence(sequence_path)
    stream = phantom_from_probe(Path(sequence_path), sequence, Path(device_set_xml), names)
    points = read_wire_points(points_xml, section, phantom, frames)
    return NWireRecording(phantom, stream, points[indices])


def phantom_from_probe(
    path: Path, sequence: TrackedSequence, device_set_xml: Path, names: ProbeNames = USUAL_NAMES
) -> PoseStream:
    """Compute the probe's pose relative to the phantom, through the reference sensor or the tracker.

    Args:
        path: the sequence's file, named in errors.
        names: of probe and reference in the sequence and the device set; without a reference, the phantom's
            pose relative to "reference" is used, else to "tracker".
    """
    definitions = read_calibrations(device_set_xml)
    for frame in ("reference", "tracker") if names.reference is None else (names.reference,):
        placed = definitions.get(f"{frame}_from_phantom")
        if placed is not None:
            with reading(path, "a sequence with a tracked probe"):
                tracked = names.stream(sequence, frame)
            with reading(device_set_xml, "a PLUS device set"):
                phantom_from_frame = rigid_from_matrix(placed.matrix, frame, "phantom").inverse()
            return _moved(phantom_from_frame, tracked)
    to = "Reference" if names.reference is None else frame_to_plus(names.reference)
    raise UnreadableFileError(
        f'{device_set_xml} does not place the phantom; needed a Transform From="Phantom" To="{to}"'
    )


def write_wire_points(
    path: Path | str, section: Section, phantom: NWirePhantom, points_px: FloatArray
) -> None:
    """Write wire crossings as one section of a PLUS calibration result.

    Args:
        points_px: (frames, wires, 2); NaN omits a wire, a frame without wires is marked Failed.
    Raises:
        InvalidInputError: the number of wires differs from the phantom's.
        OutputError: not writable.
    """
    if points_px.ndim != 3 or points_px.shape[1:] != (len(phantom.wires), 2):
        raise InvalidInputError(
            f"wire points have shape {points_px.shape}; needed (frames, {len(phantom.wires)}, 2)"
        )
    root = ElementTree.Element("ProbeCalibrationResult", version="2.0")
    part = ElementTree.SubElement(root, section)
    for index, frame in enumerate(points_px.tolist()):
        seen = [(w.name, c, r) for w, (c, r) in zip(phantom.wires, frame, strict=True) if c == c and r == r]
        status = "OK" if seen else "Failed"
        element = ElementTree.SubElement(part, "Frame", Index=str(index), SegmentationStatus=status)
        group = ElementTree.SubElement(element, "SegmentedPoints")
        for name, column, row in seen:
            ElementTree.SubElement(group, "Point", WireName=name, Position=f"{column!r} {row!r} 0")
    write_xml(Path(path), root)


def write_nwire_phantom(path: Path | str, phantom: NWirePhantom, reference_from_phantom: Rigid) -> None:
    """Write a device set with the phantom's wires and its pose relative to the reference sensor.

    Raises:
        OutputError: not writable.
    """
    placed = CoordinateDefinition(
        reference_from_phantom.target, reference_from_phantom.source, reference_from_phantom.matrix
    )
    root = ElementTree.Element("PlusConfiguration", version="2.1")
    root.append(definitions_element([placed]))
    geometry = ElementTree.SubElement(ElementTree.SubElement(root, "PhantomDefinition"), "Geometry")
    for pattern in phantom.patterns:
        element = ElementTree.SubElement(geometry, "Pattern", Type="NWire")
        for wire in pattern:
            ElementTree.SubElement(
                element,
                "Wire",
                Name=wire.name,
                EndPointFront=" ".join(map(repr, wire.front_mm.tolist())),
                EndPointBack=" ".join(map(repr, wire.back_mm.tolist())),
            )
    write_xml(Path(path), root)


def _pattern(path: Path, element: ElementTree.Element) -> tuple[Wire, Wire, Wire]:
    wires = [
        Wire(
            wire.attrib.get("Name", ""),
            numbers(path, wire, "EndPointFront", 3),
            numbers(path, wire, "EndPointBack", 3),
        )
        for wire in element.findall("Wire")
    ]
    if len(wires) != 3:
        raise UnreadableFileError(f"{path}: an NWire pattern has {len(wires)} wires; needed 3")
    return wires[0], wires[1], wires[2]


def _index(path: Path, element: ElementTree.Element) -> int:
    text = element.attrib.get("Index", "")
    if re.fullmatch(r"[0-9]{1,9}", text) is None:
        raise UnreadableFileError(f"{path}: a <Frame> has Index '{text}'; needed a whole number")
    return int(text)


def _moved(left: Rigid, stream: PoseStream) -> PoseStream:
    """Compose left @ stream for each sample; the identity changes no digit."""
    rotations, translations = stream.rotations, stream.translations_mm
    if not np.array_equal(left.matrix, np.eye(4)):
        rotations = left.rotation @ rotations
        translations = translations @ left.rotation.T + left.translation_mm
    return PoseStream(left.target, stream.source, stream.t_s, rotations, translations, stream.valid)


def read_phantom_landmarks(device_set_xml: Path | str) -> Landmarks:
    """Read the `<Landmarks>` of a `<PhantomDefinition>`, mm, frame "phantom", in the file's order.

    Raises:
        UnreadableFileError: absent, not XML, or no landmarks.
    """
    path = Path(device_set_xml)
    with reading(path, "a PLUS device set"):
        elements = [
            element
            for section in parse_xml(path, "a PLUS device set").iter("Landmarks")
            for element in section.iter("Landmark")
        ]
        if not elements:
            raise UnreadableFileError(f"{path} defines no <Landmark>; give the device set with the phantom")
        positions = np.array([numbers(path, element, "Position", 3) for element in elements])
        if problem := phantom_problem(positions):
            raise InvalidInputError(f"its phantom {problem}")
        names = tuple(element.attrib.get("Name", f"#{i + 1}") for i, element in enumerate(elements))
        return Landmarks(names, Points("phantom", positions))


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
