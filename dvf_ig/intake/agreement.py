"""Whether a session's files agree: units, motion, names, clocks, and where everything lies."""

from collections.abc import Iterator

import numpy as np

from dvf_ig.core import AnyArray, FloatArray, ImageMap, Landmarks, Points, PoseStream, Preop, plausible

from .findings import Disagreement, Finding, finding
from .heart_in_images import HeartInImages, cycle_findings, mr_order_finding
from .parts import SessionFiles
from .places import place_findings
from .preop import PreopFiles, heart_surfaces, still_heart_key
from .problems import Use
from .readers import Sweep

STILL_MM = 1.0
"""A tracker's noise over a recording (0.25 mm RMS) moves a tool that lies still by less."""
SAME_IMAGE_MM = 1.0
"""Two calibrations of one probe agree to less."""
SAME_MM = 1e-6
"""Poses that were written and read again differ by less; measured ones never agree to it."""
LEAST_POSES = 10
LEAST_SHARE = 0.5
RATE_RATIO = 2.5
"""A heart under stress beats twice as fast as in the scanner; a sampling rate that is wrong is so by more."""


def disagreements(
    files: SessionFiles, peaks_s: FloatArray, seen: HeartInImages | None
) -> tuple[Finding, ...]:
    """Find disagreements among the files that were read, none for a key that is refused already.

    Args:
        peaks_s: (k,) R peaks of the ECG.
        seen: of the heart in the images.
    """
    findings: list[Finding] = []
    for one in _all(files, peaks_s, seen):
        if not any(other.refused and other.key == one.key for other in findings):
            findings.append(one)
    return tuple(findings)


def _all(files: SessionFiles, peaks_s: FloatArray, seen: HeartInImages | None) -> Iterator[Finding]:
    units = tuple(unit_findings(files))
    yield from units
    yield from motion_findings(files)
    yield from name_findings(files)
    yield from clock_findings(files, peaks_s)
    yield from cycle_findings(seen, files)
    if not any(one.refused for one in units):
        yield from place_findings(files)


def unit_findings(files: SessionFiles) -> Iterator[Finding]:
    """Find lengths and times in another unit."""
    if files.preop is not None:
        yield from _heart(files.preop)
    if files.sweep is not None:
        if files.sweep.recorded.has_timestamps:
            yield from _stamps(files.sweep.recorded.t_s, "ultrasound", "ultrasound", "register")
        yield from _range(files.sweep.probe, "ultrasound", "register")
    if files.tool is not None:
        yield from _stamps(files.tool.t_s, "tool", "tool", "replay")
        yield from _range(files.tool, "tool", "replay")
    if isinstance(files.tip, Points):
        yield from _tip(files.tip)
    if isinstance(files.probe, ImageMap) and files.sweep is not None:
        yield from _image(files.probe, files.sweep.recorded.images)
        yield from _recorded_map(files.probe, files.sweep)


def _heart(heart: PreopFiles) -> Iterator[Finding]:
    for key, xyz_mm in heart_surfaces(heart):
        if not len(xyz_mm):
            continue  # reported of the labels themselves
        longest_mm = float(np.ptp(xyz_mm, axis=0).max())
        least, most = plausible.POSSIBLE_HEART_MM
        if not least <= longest_mm <= most:
            yield finding(Disagreement.HEART_NOT_IN_MM, key, mm=longest_mm)
        elif not plausible.HEART_MM[0] <= longest_mm <= plausible.HEART_MM[1]:
            yield finding(Disagreement.HEART_OF_UNUSUAL_SIZE, key, mm=longest_mm)


def _range(stream: PoseStream, key: str, hinders: Use) -> Iterator[Finding]:
    at_mm = stream.translations_mm[stream.valid]
    if not len(at_mm):
        return
    farthest_mm = float(np.linalg.norm(at_mm, axis=1).max())
    if farthest_mm < plausible.MARKER_MM[0] and np.ptp(at_mm, axis=0).any():
        yield finding(Disagreement.POSES_NOT_IN_MM, key, hinders, stream=stream.name, mm=farthest_mm)
    elif farthest_mm > plausible.MARKER_MM[1]:
        yield finding(
            Disagreement.POSES_OUT_OF_REACH,
            key,
            hinders,
            stream=stream.name,
            mm=farthest_mm,
            most=plausible.MARKER_MM[1],
        )
    elif key == "tool" and (moved_mm := float(np.ptp(at_mm, axis=0).max())) < STILL_MM:
        yield finding(Disagreement.TOOL_STILL, key, hinders, stream=stream.name, mm=moved_mm)


def _stamps(t_s: FloatArray, what: str, key: str, hinders: Use) -> Iterator[Finding]:
    least, most = plausible.PERIOD_S
    if len(t_s) > 1 and not least <= (period_s := float(np.median(np.diff(t_s)))) <= most:
        yield finding(
            Disagreement.STAMPS_NOT_IN_S, key, hinders, what=what, s=period_s, least=least, most=most
        )


def _tip(tip: Points) -> Iterator[Finding]:
    length_mm = float(np.linalg.norm(tip.xyz_mm[0]))
    key = "calibration.tip"
    if length_mm > plausible.TIP_MM[1]:
        yield finding(Disagreement.TIP_OUT_OF_REACH, key, "replay", mm=length_mm, most=plausible.TIP_MM[1])
    elif 0.0 < length_mm < plausible.TIP_MM[0]:
        yield finding(Disagreement.TIP_NOT_IN_MM, key, "replay", mm=length_mm)
    elif 0.0 < length_mm < plausible.USUAL_TIP_MM:
        yield finding(Disagreement.TIP_NEAR_MARKER, key, "replay", mm=length_mm)


def _image(probe: ImageMap, images: AnyArray | None) -> Iterator[Finding]:
    if images is None:
        return
    rows, columns = images.shape[1:]
    middle = probe.apply_pixels(np.array([[columns / 2, rows / 2]]))
    if (away_mm := float(np.linalg.norm(middle.xyz_mm))) > plausible.IMAGE_MM:
        yield finding(Disagreement.IMAGE_FAR_FROM_PROBE, "calibration.probe", mm=away_mm)


def _recorded_map(probe: ImageMap, sweep: Sweep) -> Iterator[Finding]:
    """Compare the calibration with the one that was recorded with the images."""
    name, images = f"{sweep.probe.source}_from_image", sweep.recorded.images
    recorded = sweep.recorded.image_maps.get(name)
    if recorded is None or images is None:
        return
    rows, columns = images.shape[1:]
    corners = np.array([[0, columns, 0, columns], [0, 0, rows, rows], [0] * 4, [1] * 4])
    apart_mm = float(np.linalg.norm(((recorded - probe.matrix) @ corners)[:3], axis=0).max())
    if apart_mm > SAME_IMAGE_MM:
        yield finding(Disagreement.OTHER_IMAGE_MAP, "calibration.probe", name=name, mm=apart_mm)


def motion_findings(files: SessionFiles) -> Iterator[Finding]:
    """Find a heart that does not move under a tool that fixtures guide."""
    if files.preop is not None and files.tool is not None:
        key = still_heart_key(files.preop)
        if key is not None:
            yield finding(Disagreement.HEART_DOES_NOT_BEAT, key)


def name_findings(files: SessionFiles) -> Iterator[Finding]:
    """Find recordings that are given under two names."""
    tool, start = files.tool, files.start
    if tool is not None:
        if files.sweep is not None and _same_poses(tool, files.sweep.probe):
            yield finding(Disagreement.TOOL_IS_PROBE, "tool", "replay")
        elif isinstance(files.tip, PoseStream) and _same_poses(tool, files.tip):
            yield finding(Disagreement.TOOL_IS_PIVOT, "tool", "replay")
    heart = files.preop
    if heart is not None and heart.named_patient not in (None, heart.preop.patient_id):
        yield finding(
            Disagreement.OTHER_PATIENT,
            "preop.surfaces_folder",
            named=str(heart.named_patient),
            patient=heart.preop.patient_id,
        )
    if heart is not None:
        yield from _whose_model(heart)
    if files.preop is not None and _mr_is_labels(files.preop.preop):
        yield finding(Disagreement.MR_IS_LABELS, "preop.mr")
    if heart is not None and (absent := _absent_labels(heart.preop)):
        yield finding(Disagreement.LABELS_ABSENT, "preop.labels", values=", ".join(map(str, absent)))
    order = None if heart is None else mr_order_finding(heart)
    if heart is not None and order is not None and still_heart_key(heart) is None:
        yield order
    marked, touched = start.landmarks_mr, start.landmarks_tracker
    if marked is not None and touched is not None and _same_points(marked, touched):
        yield finding(Disagreement.LANDMARKS_ARE_THE_SAME, "start.landmarks_tracker")


def _whose_model(heart: PreopFiles) -> Iterator[Finding]:
    """Find a model of another cine, unless the session says that both are of one patient."""
    mr, model = heart.preop.mr, heart.model
    if model is None or mr is None or heart.patient_stated or model.cine_fingerprint is None:
        return
    if mr.fingerprint() != model.cine_fingerprint:
        yield finding(Disagreement.MODEL_OF_OTHER_CINE, "preop.model")


def _same_poses(first: PoseStream, second: PoseStream) -> bool:
    """Whether two recordings have the same poses at the times that they share, LEAST_POSES or more."""
    _, here, there = np.intersect1d(first.t_s, second.t_s, return_indices=True)
    seen = first.valid[here] & second.valid[there]
    if np.count_nonzero(seen) < LEAST_POSES:
        return False
    here, there = here[seen], there[seen]
    apart = (
        np.abs(first.translations_mm[here] - second.translations_mm[there]).max(),
        np.abs(first.rotations[here] - second.rotations[there]).max(),
    )
    return bool(max(apart) < SAME_MM)


def _mr_is_labels(preop: Preop) -> bool:
    mr, labels = preop.mr, preop.labels
    if mr is None or labels is None or mr.values.shape != labels.values.shape:
        return False
    return bool(np.array_equal(mr.values[0], labels.values[0]))


def _absent_labels(preop: Preop) -> list[int]:
    """Values of organ and cavity that the label image lacks; none if it lacks the organ, which is refused."""
    labels = preop.labels if preop.labels is not None else preop.ed_labels
    if labels is None:
        return []
    named = sorted({*preop.organ_labels, *preop.cavity_labels})
    absent = [value for value in named if not (labels.values == value).any()]
    no_organ = bool(preop.organ_labels) and set(preop.organ_labels) <= set(absent)
    return [] if no_organ else absent


def _same_points(marked: Landmarks, touched: Landmarks) -> bool:
    names, here, there = marked.paired_with(touched)
    return len(names) > 0 and bool((np.abs(here.xyz_mm - there.xyz_mm) < SAME_MM).all())


def clock_findings(files: SessionFiles, peaks_s: FloatArray) -> Iterator[Finding]:
    """Find recordings of another time, or of another rate.

    Args:
        peaks_s: (k,) R peaks of the ECG.
    """
    if files.ecg is None:
        return
    ecg_s = files.ecg.t_s
    others: list[tuple[str, FloatArray, Use]] = []
    if files.sweep is not None:
        others.append(("ultrasound", files.sweep.recorded.t_s, "register"))
    if files.tool is not None:
        others.append(("tool", files.tool.t_s, "replay"))
    for what, t_s, use in others:
        share = float(np.mean((t_s >= ecg_s[0]) & (t_s <= ecg_s[-1])))
        if 0.0 < share < LEAST_SHARE:
            yield finding(Disagreement.LITTLE_COMMON_TIME, "ecg", use, what=what, share=share)
    yield from _rate(files, peaks_s)


def _rate(files: SessionFiles, peaks_s: FloatArray) -> Iterator[Finding]:
    timing = _rr_s(files)
    if timing is None or len(peaks_s) < 3:
        return
    rr_s = float(np.median(np.diff(peaks_s)))
    if max(rr_s / timing, timing / rr_s) > RATE_RATIO:
        yield finding(Disagreement.ECG_OF_ANOTHER_RATE, "ecg", bpm=60.0 / rr_s, model_bpm=60.0 / timing)


def _rr_s(files: SessionFiles) -> float | None:
    """RR interval of the pre-operative heart in s; None if it was assumed."""
    if files.preop is None:
        return None
    preop, model = files.preop.preop, files.preop.model
    timing = model.timing if model is not None else None
    for series in (preop.labels, preop.mr, *preop.surfaces):
        timing = timing or (None if series is None else series.timing)
    return None if timing is None or timing.rr_assumed else timing.rr_s
