"""Whether images, tool and landmarks lie where the heart is, at the start that the files give."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from dvf_ig.core import RAS_FROM_LPS, FloatArray, ImageMap, InvalidInputError, Points, PoseStream, Rigid
from dvf_ig.registration import start_from_landmarks

from .findings import Disagreement, Finding, finding
from .landmark_pairs import exchanged_names, unit_of
from .parts import SessionFiles
from .preop import heart_surfaces, heart_vertices
from .readers import StartFiles

OFF_MM = 100.0
"""Images, landmarks and tools that all stay this far from the box about the heart are of something else: a
start is off by 10 to 30 mm."""
NO_WORK_MM = 50.0
"""A tool that comes no nearer never works at this heart, though it may be tracked rightly."""
BESIDE_MM = 10.0
"""Largest distance from the nearest surface of their own heart or its chambers that three in four landmarks
have: points on surfaces 1 to 2 mm. On hearts of other patients they have 12 to 38 mm."""
THREE_IN_FOUR = 0.75
FEWEST_LANDMARKS, FEWEST_VERTICES = 3, 100
FAR_MM = 500.0
"""A tool this far away is not in reach of an operating table's middle."""
MOST_POSES = 200
GRID = 5
"""Points along each side of an image."""
CLEARLY, LEAST_AREA = 4.0, 0.1
"""Another reading of the transforms explains images that miss the heart if this multiple of their area, and
at least this share, then lies in the box about it. In a synthetic recording it is 0.45; 0.05 with an inverse
calibration, 0 with inverse or exchanged poses."""
FLIP = np.diag(np.diag(RAS_FROM_LPS)[:3])
Box = tuple[FloatArray, FloatArray]
"""Lower and upper corner (3,)."""


def place_findings(files: SessionFiles) -> Iterator[Finding]:
    """Find images, tools and landmarks that lie nowhere near the heart."""
    heart = _heart_box(files)
    if heart is None:
        return
    findings = [*_landmark_findings(files, heart)]
    yield from findings
    if any(one.refused for one in findings):
        return
    start = _start(files.start)
    if start is None:
        return
    findings = [*_image_findings(files, start, heart)]
    yield from findings
    if any(one.refused for one in findings):
        return
    if files.tool is not None and isinstance(files.tip, Points):
        tips = _moved(files.tool, files.tip.xyz_mm)
        off_mm = float(_outside_mm(start.apply_array(tips), heart).min()) if len(tips) else 0.0
        if off_mm > FAR_MM:
            yield finding(Disagreement.TOOL_OFF_HEART, "tool", "replay", mm=off_mm)
        elif off_mm > NO_WORK_MM:
            yield finding(Disagreement.TOOL_FAR_FROM_HEART, "tool", "replay", mm=off_mm)


def _landmark_findings(files: SessionFiles, heart: Box) -> Iterator[Finding]:
    """Find landmarks in another unit, off the heart, or under each other's names."""
    marked, touched = files.start.landmarks_mr, files.start.landmarks_tracker
    if marked is None:
        return
    if touched is not None:
        _, there, here = marked.paired_with(touched)
        sides = (
            ("start.landmarks_mr", there.xyz_mm, here.xyz_mm),
            ("start.landmarks_tracker", here.xyz_mm, there.xyz_mm),
        )
        for key, xyz_mm, others_mm in sides if len(here) else ():
            unit = unit_of(xyz_mm, others_mm)
            if unit is not None:
                yield finding(Disagreement.LANDMARKS_NOT_IN_MM, key, unit=unit)
                return
        exchanged = exchanged_names(marked, touched)
        if exchanged is not None:
            yield finding(
                Disagreement.NAMES_EXCHANGED,
                "start.landmarks_tracker",
                given=exchanged.given_mm,
                mm=exchanged.exchanged_mm,
                names=exchanged.listed,
            )
    off_mm = float(_outside_mm(marked.points.xyz_mm, heart).min())
    if off_mm > OFF_MM:
        yield finding(Disagreement.LANDMARKS_OFF_HEART, "start.landmarks_mr", mm=off_mm)
    elif (beside_mm := _beside_mm(files, marked.points.xyz_mm)) > BESIDE_MM:
        yield finding(Disagreement.LANDMARKS_BESIDE_HEART, "start.landmarks_mr", mm=beside_mm)


def _image_findings(files: SessionFiles, start: Rigid, heart: Box) -> Iterator[Finding]:
    """Find why images miss the heart: a transform that is inverse, flipped, exchanged or of another day."""
    sweep, probe = files.sweep, files.probe
    if sweep is None or sweep.recorded.images is None or not isinstance(probe, ImageMap):
        return
    points_mm = _image_points(probe, sweep.recorded.images.shape[1:])

    def off_mm(
        start: Rigid = start, poses: PoseStream = sweep.probe, at: FloatArray = points_mm
    ) -> FloatArray:
        return _outside_mm(start.apply_array(_moved(poses, at)), heart)

    given_mm = off_mm()
    if not len(given_mm):
        return
    share = _share(given_mm)
    key = "start.transform" if files.start.start is not None else "start.landmarks_tracker"
    flipped = (Rigid(start.target, start.source, FLIP @ start.rotation, FLIP @ start.translation_mm),
               Rigid(start.target, start.source, start.rotation @ FLIP, start.translation_mm))  # fmt: skip
    inverse_start = _as_named(start.inverse(), start)
    inverse_image = ImageMap(_as_named(probe.rigid.inverse(), probe.rigid), probe.scale_mm_per_px)
    inverse_points = _image_points(inverse_image, sweep.recorded.images.shape[1:])
    others = [
        (Disagreement.INVERSE_START, key, [off_mm(start=inverse_start)]),
        (Disagreement.START_FLIPPED, key, [off_mm(start=one) for one in flipped]),
        (Disagreement.INVERSE_POSES, "ultrasound", [off_mm(poses=_inverse(sweep.probe))]),
        (Disagreement.INVERSE_PROBE, "calibration.probe", [off_mm(at=inverse_points)]),
    ]
    if files.tool is not None:
        exchanged = off_mm(poses=files.tool)
        others.insert(0, (Disagreement.PROBE_AND_TOOL_EXCHANGED, "ultrasound.probe_name", [exchanged]))
    for cause, concerned, distances in others:
        other = max(_share(one) for one in distances)
        if other >= max(LEAST_AREA, CLEARLY * share):
            yield finding(cause, concerned, share=share, other=other)
            return
    nearest_mm = float(given_mm.min())
    if nearest_mm > OFF_MM:
        yield finding(Disagreement.IMAGES_OFF_HEART, key, mm=nearest_mm)


def _heart_box(files: SessionFiles) -> Box | None:
    """The box about the heart, frame "mr"."""
    if files.preop is None:
        return None
    there = [xyz_mm for _, xyz_mm in heart_surfaces(files.preop) if len(xyz_mm)]
    return None if not there else (there[0].min(axis=0), there[0].max(axis=0))


def _beside_mm(files: SessionFiles, marked_mm: FloatArray) -> float:
    """Distance that three in four (n, 3) landmarks have from the heart at most; 0 if it cannot be judged."""
    surfaces = [] if files.preop is None else list(heart_vertices(files.preop))
    vertices = np.concatenate([np.empty((0, 3)), *surfaces])
    if len(vertices) < FEWEST_VERTICES or len(marked_mm) < FEWEST_LANDMARKS:
        return 0.0
    distances_mm = cKDTree(vertices).query(marked_mm)[0]
    return float(np.quantile(distances_mm, THREE_IN_FOUR))


def _outside_mm(xyz_mm: FloatArray, box: Box) -> FloatArray:
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
        return None  # reported of the landmarks themselves


def _image_points(probe: ImageMap, shape: tuple[int, ...]) -> FloatArray:
    """(n, 3) points all over an image of (rows, columns), frame "probe"."""
    rows, columns = shape
    sides = np.meshgrid(np.linspace(0, columns, GRID), np.linspace(0, rows, GRID))
    return probe.apply_pixels(np.stack(sides, axis=-1).reshape(-1, 2)).xyz_mm


def _share(off_mm: FloatArray) -> float:
    """Share of the images' area that lies at the heart."""
    return float((off_mm == 0.0).mean()) if len(off_mm) else 0.0


def _inverse(stream: PoseStream) -> PoseStream:
    """Poses read the wrong way round."""
    turned = np.swapaxes(stream.rotations, 1, 2)
    shifted = -np.einsum("nij,nj->ni", turned, stream.translations_mm)
    return replace(stream, rotations=turned, translations_mm=shifted)


def _as_named(pose: Rigid, names: Rigid) -> Rigid:
    return Rigid(names.target, names.source, pose.rotation, pose.translation_mm)


def _moved(stream: PoseStream, xyz_mm: FloatArray) -> FloatArray:
    """(p·n, 3) points (n, 3) of a marker at MOST_POSES of its valid poses at most."""
    valid = np.flatnonzero(stream.valid)
    chosen = valid[:: max(1, len(valid) // MOST_POSES)]
    turned = np.einsum("pij,nj->pni", stream.rotations[chosen], xyz_mm)
    return np.asarray(turned + stream.translations_mm[chosen][:, None]).reshape(-1, 3)
