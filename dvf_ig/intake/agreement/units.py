"""Whether lengths and times are in mm and s, as far as the size of what they measure tells."""

from collections.abc import Iterator

import numpy as np

from dvf_ig.core.arrays import AnyArray, FloatArray
from dvf_ig.core.recordings.scenario import Preop
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.points import Points
from dvf_ig.intake.agreement.finding import Disagreement, Finding, finding
from dvf_ig.intake.parts import SessionParts
from dvf_ig.intake.preop import PreopFiles
from dvf_ig.intake.problem import Use

HEART_MM = (60.0, 200.0)
"""Longest side of the box about its surfaces: a small left ventricle; a dilated heart with its vessels."""
POSSIBLE_HEART_MM = (25.0, 500.0)
"""Outside it is no heart: a newborn's has 40 mm, and one that is in cm, inches or m 20 at most."""
NEAREST_MM = 10.0
"""No marker is this near to the origin of a tracker or to another marker; 10 m are beyond every tracker."""
FARTHEST_MM = 10_000.0
PERIOD_S = (1e-4, 1.0)
"""Between samples of poses or images: 10 kHz to one a second. 12 images a second in ms have 83 'seconds'."""
STILL_MM = 1.0
"""A tracker's noise over a recording (0.25 mm RMS) moves a tool that lies still by less."""
LONGEST_TOOL_MM = 1000.0
SHORTEST_TOOL_MM = 2.0
"""Tips calibrated in m lie 0.05 to 0.5 from the marker; a tip that is the marker's origin lies at 0."""
PROBE_MM = 300.0
"""Transthoracic probes hold their marker 50 to 150 mm from the middle of the image."""


def unit_findings(parts: SessionParts) -> Iterator[Finding]:
    """What is of another unit."""
    if parts.preop is not None:
        yield from _heart(parts.preop)
    if parts.sweep is not None:
        if parts.sweep.recorded.has_timestamps:
            yield from _stamps(parts.sweep.recorded.t_s, "ultrasound", "ultrasound", "register")
        yield from _range(parts.sweep.probe, "ultrasound", "register")
    if parts.tool is not None:
        yield from _stamps(parts.tool.t_s, "tool", "tool", "replay")
        yield from _range(parts.tool, "tool", "replay")
    if isinstance(parts.tip, Points):
        yield from _tip(parts.tip)
    if isinstance(parts.probe, ImageMap) and parts.sweep is not None:
        yield from _image(parts.probe, parts.sweep.recorded.images)


def _heart(files: PreopFiles) -> Iterator[Finding]:
    for key, xyz_mm in heart_surfaces(files):
        if not len(xyz_mm):
            continue  # told of the labels themselves
        longest_mm = float(np.ptp(xyz_mm, axis=0).max())
        least, most = POSSIBLE_HEART_MM
        if not least <= longest_mm <= most:
            yield finding(Disagreement.HEART_NOT_IN_MM, key, mm=longest_mm)
        elif not HEART_MM[0] <= longest_mm <= HEART_MM[1]:
            yield finding(Disagreement.HEART_OF_UNUSUAL_SIZE, key, mm=longest_mm)


def heart_surfaces(files: PreopFiles) -> Iterator[tuple[str, FloatArray]]:
    """(n, 3) points in mm of the heart at end-diastole, by the keys of the files that hold them."""
    preop, model = files.preop, files.model
    if model is not None:
        yield "preop.model", np.asarray(model.reference[model.ed_phase].vertices_mm)
    if preop.labels is not None or preop.ed_labels is not None:
        yield "preop.labels", _corners_of_labels(preop)
    fixture = [series for series in preop.surfaces if series.name == preop.surface]
    for series in fixture if model is None else ():
        yield "preop.surfaces_folder", np.asarray(series.vertices_mm[0])


def _corners_of_labels(preop: Preop) -> FloatArray:
    """(8, 3) corners of the box about the organ's voxels, in the axes of the image; (0, 3) without any."""
    of_cycle, of_phase = preop.labels, preop.ed_labels
    if of_cycle is not None:
        values, grid = of_cycle.values[preop.ed_phase % len(of_cycle.timing)], of_cycle.grid
    elif of_phase is not None:
        values, grid = of_phase.values, of_phase.grid
    else:
        return np.empty((0, 3))
    organ = np.isin(values, preop.organ_labels) if preop.organ_labels else values != 0
    sides = []
    for axis in range(3):
        there = np.flatnonzero(organ.any(axis=tuple(a for a in range(3) if a != axis)))
        if not len(there):
            return np.empty((0, 3))
        sides.append((there[0] - 0.5, there[-1] + 0.5))
    corners = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid.to_mm(corners)


def _range(stream: PoseStream, key: str, hinders: Use) -> Iterator[Finding]:
    at_mm = stream.translations_mm[stream.valid]
    if not len(at_mm):
        return
    farthest_mm = float(np.linalg.norm(at_mm, axis=1).max())
    if farthest_mm < NEAREST_MM and np.ptp(at_mm, axis=0).any():
        yield finding(Disagreement.POSES_NOT_IN_MM, key, hinders, stream=stream.name, mm=farthest_mm)
    elif farthest_mm > FARTHEST_MM:
        yield finding(
            Disagreement.POSES_OUT_OF_REACH,
            key,
            hinders,
            stream=stream.name,
            mm=farthest_mm,
            most=FARTHEST_MM,
        )
    elif key == "tool" and (moved_mm := float(np.ptp(at_mm, axis=0).max())) < STILL_MM:
        yield finding(Disagreement.TOOL_STILL, key, hinders, stream=stream.name, mm=moved_mm)


def _stamps(t_s: FloatArray, what: str, key: str, hinders: Use) -> Iterator[Finding]:
    least, most = PERIOD_S
    if len(t_s) > 1 and not least <= (period_s := float(np.median(np.diff(t_s)))) <= most:
        yield finding(
            Disagreement.STAMPS_NOT_IN_S, key, hinders, what=what, s=period_s, least=least, most=most
        )


def _tip(tip: Points) -> Iterator[Finding]:
    length_mm = float(np.linalg.norm(tip.xyz_mm[0]))
    key = "calibration.tip"
    if length_mm > LONGEST_TOOL_MM:
        yield finding(Disagreement.TIP_OUT_OF_REACH, key, "replay", mm=length_mm, most=LONGEST_TOOL_MM)
    elif 0.0 < length_mm < SHORTEST_TOOL_MM:
        yield finding(Disagreement.TIP_NEAR_MARKER, key, "replay", mm=length_mm)


def _image(probe: ImageMap, images: AnyArray | None) -> Iterator[Finding]:
    if images is None:
        return
    rows, columns = images.shape[1:]
    middle = probe.apply_pixels(np.array([[columns / 2, rows / 2]]))
    if (away_mm := float(np.linalg.norm(middle.xyz_mm))) > PROBE_MM:
        yield finding(Disagreement.IMAGE_FAR_FROM_PROBE, "calibration.probe", mm=away_mm)
