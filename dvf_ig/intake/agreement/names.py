"""Whether each file is what the session takes it for: not one recording under two names."""

from collections.abc import Iterator

import numpy as np

from dvf_ig.core.recordings.scenario import Preop
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.core.space.points import Landmarks
from dvf_ig.intake.agreement.finding import Disagreement, Finding, finding
from dvf_ig.intake.parts import SessionParts

SAME_MM = 1e-6
"""Poses that were written and read again differ by less; measured ones never agree to it."""
LEAST_POSES = 10


def name_findings(parts: SessionParts) -> Iterator[Finding]:
    """What is the same recording as another one."""
    tool, start = parts.tool, parts.start
    if tool is not None:
        if parts.sweep is not None and _same_poses(tool, parts.sweep.probe):
            yield finding(Disagreement.TOOL_IS_PROBE, "tool", "replay")
        elif isinstance(parts.tip, PoseStream) and _same_poses(tool, parts.tip):
            yield finding(Disagreement.TOOL_IS_PIVOT, "tool", "replay")
    heart = parts.preop
    if heart is not None and heart.named_patient not in (None, heart.preop.patient_id):
        yield finding(
            Disagreement.OTHER_PATIENT,
            "preop.surfaces_folder",
            named=str(heart.named_patient),
            patient=heart.preop.patient_id,
        )
    if parts.preop is not None and _mr_is_labels(parts.preop.preop):
        yield finding(Disagreement.MR_IS_LABELS, "preop.mr")
    marked, touched = start.landmarks_mr, start.landmarks_tracker
    if marked is not None and touched is not None and _same_points(marked, touched):
        yield finding(Disagreement.LANDMARKS_ARE_THE_SAME, "start.landmarks_tracker")


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


def _same_points(marked: Landmarks, touched: Landmarks) -> bool:
    names, here, there = marked.paired_with(touched)
    return len(names) > 0 and bool((np.abs(here.xyz_mm - there.xyz_mm) < SAME_MM).all())
