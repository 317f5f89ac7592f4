"""Whether images, tool and landmarks lie where the heart is, at the start that the files give."""

from collections.abc import Iterator

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.points import Points
from dvf_ig.core.space.rigid import Rigid
from dvf_ig.registration import start_from_landmarks

from .findings import Disagreement, Finding, finding
from .parts import SessionFiles
from .preop import heart_surfaces
from .readers import StartFiles

OFF_MM = 100.0
"""Images, landmarks and tools that all stay this far from the box about the heart are of something else: a
start is off by 10 to 30 mm."""
NO_WORK_MM = 50.0
"""A tool that comes no nearer never works at this heart, though it may be tracked rightly."""
FAR_MM = 500.0
"""A tool this far away is not in reach of an operating table's middle."""
MOST_POSES = 200
GRID = 5
"""Points along each side of an image."""
MISSES, REACHES = 0.1, 0.5
"""Shares of images that reach the box about the heart: no probe that images it reaches it in so few, and none
elsewhere in so many. In a synthetic recording all do; with the tool's poses in place of the probe's, none."""


def place_findings(files: SessionFiles) -> Iterator[Finding]:
    """Find images, tools and landmarks that lie nowhere near the heart."""
    heart = _heart_box(files)
    if heart is None:
        return
    marked = files.start.landmarks_mr
    if marked is not None:
        off_mm = float(_outside_mm(marked.points.xyz_mm, heart).min())
        if off_mm > OFF_MM:
            yield finding(Disagreement.LANDMARKS_OFF_HEART, "start.landmarks_mr", mm=off_mm)
            return
    start = _start(files.start)
    if start is None:
        return
    images_off_mm = _images_off_mm(files, start, heart)
    if images_off_mm is not None:
        exchanged = _exchanged(files, start, heart, images_off_mm)
        if exchanged is not None:
            yield exchanged
            return
        if (off_mm := float(images_off_mm.min())) > OFF_MM:
            key = "start.transform" if files.start.start is not None else "start.landmarks_tracker"
            yield finding(Disagreement.IMAGES_OFF_HEART, key, mm=off_mm)
            return
    if files.tool is not None and isinstance(files.tip, Points):
        tips = _moved(files.tool, files.tip.xyz_mm)
        off_mm = float(_outside_mm(start.apply_array(tips), heart).min()) if len(tips) else 0.0
        if off_mm > FAR_MM:
            yield finding(Disagreement.TOOL_OFF_HEART, "tool", "replay", mm=off_mm)
        elif off_mm > NO_WORK_MM:
            yield finding(Disagreement.TOOL_FAR_FROM_HEART, "tool", "replay", mm=off_mm)


def _heart_box(files: SessionFiles) -> tuple[FloatArray, FloatArray] | None:
    """Lower and upper corner (3,) of the box about the heart, frame "mr"."""
    if files.preop is None:
        return None
    there = [xyz_mm for _, xyz_mm in heart_surfaces(files.preop) if len(xyz_mm)]
    return None if not there else (there[0].min(axis=0), there[0].max(axis=0))


def _outside_mm(xyz_mm: FloatArray, box: tuple[FloatArray, FloatArray]) -> FloatArray:
    """(n,) distance from a box, 0 inside."""
    low, high = box
    beyond = np.maximum(np.maximum(low - xyz_mm, xyz_mm - high), 0.0)
    return np.asarray(np.linalg.norm(beyond, axis=1))


def _start(start: StartFiles) -> Rigid | None:
    """mr_from_tracker, as far as a transform or landmarks give it."""
    if start.start is not None:
        return start.start
    if start.landmarks_mr is None or start.landmarks_tracker is None:
        return None
    try:
        return start_from_landmarks(start.landmarks_mr, start.landmarks_tracker).mr_from_tracker
    except InvalidInputError:
        return None  # told of the landmarks themselves


def _images_off_mm(
    files: SessionFiles, start: Rigid, heart: tuple[FloatArray, FloatArray], probe: PoseStream | None = None
) -> FloatArray | None:
    """(p,) distance of each image from the box about the heart; None if no pose or calibration is known.

    Args:
        probe: poses of the images, if not those of the sweep.
    """
    if files.sweep is None or files.sweep.recorded.images is None or not isinstance(files.probe, ImageMap):
        return None
    rows, columns = files.sweep.recorded.images.shape[1:]
    sides = np.meshgrid(np.linspace(0, columns, GRID), np.linspace(0, rows, GRID))
    points = files.probe.apply_pixels(np.stack(sides, axis=-1).reshape(-1, 2)).xyz_mm
    at = _moved(files.sweep.probe if probe is None else probe, points)
    if not len(at):
        return None
    return np.asarray(_outside_mm(start.apply_array(at), heart).reshape(-1, len(points)).min(axis=1))


def _exchanged(
    files: SessionFiles, start: Rigid, heart: tuple[FloatArray, FloatArray], images_off_mm: FloatArray
) -> Finding | None:
    """Find probe and tool exchanged: images miss the heart by the probe's poses, not by the tool's."""
    share = float((images_off_mm == 0.0).mean())
    if files.tool is None or share > MISSES:
        return None
    others_off_mm = _images_off_mm(files, start, heart, files.tool)
    if others_off_mm is None or (other := float((others_off_mm == 0.0).mean())) < REACHES:
        return None
    return finding(Disagreement.PROBE_AND_TOOL_EXCHANGED, "ultrasound.probe_name", share=share, other=other)


def _moved(stream: PoseStream, xyz_mm: FloatArray) -> FloatArray:
    """(p·n, 3) points (n, 3) of a marker at MOST_POSES of its valid poses at most."""
    valid = np.flatnonzero(stream.valid)
    chosen = valid[:: max(1, len(valid) // MOST_POSES)]
    turned = np.einsum("pij,nj->pni", stream.rotations[chosen], xyz_mm)
    return np.asarray(turned + stream.translations_mm[chosen][:, None]).reshape(-1, 3)
