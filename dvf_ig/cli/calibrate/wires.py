"""Wires of an N-wire recording for `dvf-ig calibrate probe`: from a table, or from the images."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dvf_ig.cli.shell import progress, wrote

if TYPE_CHECKING:
    from dvf_ig.calibration import WireImageOptions, WireSegmentation
    from dvf_ig.core import NWireRecording, WireSearch
    from dvf_ig.io import ProbeNames


@dataclass(frozen=True, slots=True, eq=False)
class WireRecording:
    """Recording with the segmentation of its wires, which is None if a table gave them."""

    recording: "NWireRecording"
    segmentation: "WireSegmentation | None"


def read_wires(
    sequence: Path,
    device_set: Path,
    table: Path | None,
    section: Literal["CalibrationData", "ValidationData"],
    names: "ProbeNames",
    picture: Path | None = None,
) -> WireRecording:
    """Read wires from a section of a PLUS result, or find them in the images without a table.

    Args:
        names: names of the probe and its reference in the sequence.
        picture: PNG of the detections in the images, also written if there are not enough.
    """
    from dvf_ig.calibration import recording_of, segment_wires
    from dvf_ig.core import InvalidInputError
    from dvf_ig.io import (
        phantom_from_probe,
        read_nwire_phantom,
        read_nwire_recording,
        read_sequence,
        read_wire_search,
    )
    from dvf_ig.report import write_wire_picture

    if table is not None:
        if picture is not None:
            raise InvalidInputError("--picture shows wires found in images; leave out --points to find them")
        return WireRecording(read_nwire_recording(sequence, device_set, table, section, names), None)
    phantom = read_nwire_phantom(device_set)
    recorded = read_sequence(sequence)
    poses = phantom_from_probe(sequence, recorded, device_set, names)
    options = wire_image_options(read_wire_search(device_set))
    with progress("images") as report:
        segmented = segment_wires(recorded, phantom, options=options, progress=report)
    if picture is not None:
        title = f"{sequence.name}: wires found in {segmented.used} of {len(segmented.frames)} frames"
        write_wire_picture(picture, recorded, segmented, title=title)
        wrote(picture, "image")
    return WireRecording(recording_of(segmented, phantom, poses), segmented)


def wire_image_options(search: "WireSearch") -> "WireImageOptions":
    """Read the settings of the search from a device set; missing ones keep their default."""
    from dvf_ig.calibration import WireImageOptions

    options = WireImageOptions()
    dots, pattern = options.dots, options.pattern
    if search.candidates is not None:
        # more cost little, and a bright wall can take many of them
        dots = replace(dots, most=max(dots.most, search.candidates))
    if search.collinear_mm is not None:
        pattern = replace(pattern, lines=replace(pattern.lines, collinear_mm=search.collinear_mm))
    return replace(options, spacing_mm=search.spacing_mm, clip=search.clip, dots=dots, pattern=pattern)


def segmentation_json(seen: WireRecording | None) -> dict[str, Any] | None:
    """Count frames used and left out by reason; None if a table gave the wires."""
    if seen is None or seen.segmentation is None:
        return None
    segmented = seen.segmentation
    return {"frames_used": segmented.used, "frames": len(segmented.frames), "reasons": segmented.reasons}


def segmentation_rows(seen: WireRecording, validated: WireRecording | None) -> list[tuple[str, str]]:
    """Build rows of the share of frames used, and the number left out by reason."""
    rows = []
    for what, wires in (("calibration", seen), ("validation", validated)):
        if wires is None or wires.segmentation is None:
            continue
        used, frames = wires.segmentation.used, len(wires.segmentation.frames)
        rows.append((f"{what} wires", f"found in {used} of {frames} frames ({100 * used / frames:.0f} %)"))
        rows += [("left out", f"{n} frames: {why}") for why, n in wires.segmentation.reasons.items()]
    return rows
