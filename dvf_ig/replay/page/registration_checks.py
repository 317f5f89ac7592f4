"""The evidence of a registration in words: what each check measures, its value, its limit and its outcome."""

import math
from dataclasses import replace

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, Stop
from dvf_ig.registration import LANDMARKS_MM, PairEvidence, RegistrationResult
from dvf_ig.registration.evidence.checks import WRONG_MM
from dvf_ig.registration.evidence.phase_offset import SUSPICIOUS_LOG_RATIO, SUSPICIOUS_S
from dvf_ig.registration.shape.change import (
    LARGEST_APART_MM,
    LARGEST_PHASES_APART_MM,
    LARGEST_SHARED,
    Halves,
)
from dvf_ig.registration.shape.estimate import LARGEST_SLOPE
from dvf_ig.report.registration import Check, Outcome

BOUNDARY_UNSEEN = "no boundary seen"
HALVES = ("Halves of the frames", "either half of the frames", LARGEST_APART_MM)
PHASES = ("Systole", "systole and by the rest of the cycle", LARGEST_PHASES_APART_MM)


def checks_of(result: RegistrationResult) -> list[Check]:
    """List the checks of a registration: those of a heart, or those of a pair of images."""
    touched = result.touched
    if result.evidence.pair is not None:
        every = [_overlap(result), _z_score(result), *_disagreements(result), _pair(result.evidence.pair)]
        every += [_search(result), _geometry(result)]
        return [check for check in every if check.outcome is not Outcome.NOT_CHECKED]
    return [
        _overlap(result),
        _z_score(result),
        *_disagreements(result),
        _phase_offset(result),
        _image_offset(result),
        *_shape(result),
        _at_most(
            "Touched landmarks",
            "mean distance over the heart from the pose that touched landmarks give",
            result.landmarks_mm,
            LANDMARKS_MM,
        ),
        _at_most(
            "Touched surface",
            "median distance of points touched on the heart from the model's surface",
            None if touched is None else touched.median_mm,
            math.inf if touched is None else touched.limit_mm,
        ),
        _search(result),
        _geometry(result),
    ]


def _overlap(result: RegistrationResult) -> Check:
    least, whole = result.options.min_overlap, result.coverage is None
    return Check(
        "Overlap",
        "share of the ultrasound that lies inside the pre-operative image"
        if whole
        else "share that the ultrasound images of the part of the heart that the pre-operative image covers",
        f"{100 * result.overlap:.0f} %",
        f"at least {100 * least:.0f} %",
        _outcome(result.overlap >= least),
    )


def _z_score(result: RegistrationResult) -> Check:
    value, least = result.evidence.z_score, result.options.limits.z_score
    return Check(
        "Better than wrong poses",
        f"standard deviations by which the similarity exceeds that of poses {WRONG_MM:g} mm away",
        f"{value:.1f}",
        f"at least {least:.1f}",
        _outcome(value >= least),
    )


def _disagreements(result: RegistrationResult) -> list[Check]:
    evidence, limits = result.evidence, result.options.limits
    if result.shape is not None and result.shape.followed is not None:
        evidence = evidence.of_changed_shape()
    return [
        _at_most(
            "Interleaved halves",
            "distance between the poses that every second slice and the rest would choose",
            evidence.split_half_mm,
            limits.split_half_mm,
        ),
        _at_most(
            "Parts of the cycle",
            "distance between the poses that one third of the heart's cycle and the rest would choose",
            evidence.phase_mm,
            limits.phase_mm,
        ),
        _at_most(
            "Half-volumes",
            "distance of the poses that each half of space would choose from that of all",
            evidence.half_volume_mm,
            limits.half_volume_mm,
        ),
        _at_most(
            "Boundary and grey levels",
            "distance between the pose that the borders of blood would choose and that of the similarity",
            evidence.boundary_mm,
            limits.boundary_mm,
            unknown=BOUNDARY_UNSEEN,
        ),
    ]


def _phase_offset(result: RegistrationResult) -> Check:
    offset = result.evidence.phase_offset
    name, measures = (
        "ECG and images",
        "how late the ECG is, by the phase of the cycle that fits the images best",
    )
    if offset is None:
        return Check(name, measures, "", "", Outcome.NOT_CHECKED)
    return Check(
        name,
        measures,
        f"{1e3 * offset.offset_s:.0f} ms (log-likelihood ratio {offset.log_likelihood_ratio:.1f})",
        f"at most {1e3 * SUSPICIOUS_S:.0f} ms, or a ratio of at most {SUSPICIOUS_LOG_RATIO:g}",
        _outcome(not offset.suspicious),
    )


def _image_offset(result: RegistrationResult) -> Check:
    offset = result.evidence.image_offset
    name, measures = "Probe calibration", "how the image lies to its probe by the views of the heart"
    if offset is None:
        return Check(name, measures, "", "", Outcome.NOT_CHECKED)
    return Check(
        name,
        measures,
        f"{offset.moved_mm:.1f} mm and {offset.turned_deg:.1f}° elsewhere (log-likelihood ratio "
        f"{offset.log_likelihood_ratio:.1f})",
        f"a ratio of at most {offset.limit:.1f}",
        _outcome(not offset.suspicious),
    )


def _shape(result: RegistrationResult) -> list[Check]:
    """Whether fixtures can follow the change of the heart's shape, where one was found.

    A small one that they cannot leaves the heart rigid: its checks refuse nothing.
    """
    shape = result.shape
    if shape is None or shape.partly:
        return []
    checks = [
        Check(
            "Abruptness of the change of shape",
            "largest slope of the shift of the heart's walls",
            f"{shape.warp.steepest:.2f}",
            f"at most {LARGEST_SLOPE:g}",
            _outcome(shape.warp.steepest <= LARGEST_SLOPE),
        ),
        Check(
            "What the change of shape leaves",
            "mean square of the boundary's shared error, 1 a priori",
            f"{shape.shared:.2f}",
            f"at most {LARGEST_SHARED:g}",
            _outcome(shape.shared <= LARGEST_SHARED),
        ),
        *([] if shape.halves is None else [_held_out(shape.halves), _apart(shape.halves, *HALVES)]),
        *([] if shape.phases is None else [_apart(shape.phases, *PHASES)]),
    ]
    if shape.needed:
        return checks
    return [one if one.outcome is Outcome.PASSED else replace(one, outcome=Outcome.RIGID) for one in checks]


def _held_out(halves: Halves) -> Check:
    return Check(
        "Frames held out",
        "misfit of half of the frames by the change of shape that the others show, 1 without a change",
        f"{halves.held_out:.2f}",
        "below 1",
        _outcome(halves.held_out < 1.0),
    )


def _apart(halves: Halves, name: str, frames: str, largest_mm: float) -> Check:
    return Check(
        name,
        f"RMS distance between the seen walls by {frames}",
        f"{halves.apart_mm:.2f} mm",
        f"at most {largest_mm:g} mm",
        _outcome(halves.apart_mm <= largest_mm),
    )


def _pair(pair: PairEvidence) -> Check:
    name = "Self-consistency"
    measures = (
        "log-odds against the pose: from parts of the ultrasound registered on their own, the share of "
        "displaced starts that end here, what the next best pose explains, and the distance moved"
    )
    value = (
        f"{pair.doubt:.1f} (parts disagree by {pair.parts_mm:.2f} mm, {100 * pair.agreeing_starts:.0f} % of "
        f"the starts agree, the next best pose explains {100 * pair.next_best_share:.0f} %)"
    )
    return Check(name, measures, value, "at most 0", _outcome(pair.doubt <= 0.0))


def _search(result: RegistrationResult) -> Check:
    limit = result.options.bound_mm
    iterating = result.stop is Stop.MAX_ITERATIONS and result.moved_mm <= limit
    return Check(
        "Distance moved",
        f"mean distance between start and result, over a ball of {HEART_RADIUS_MM:g} mm radius"
        + ("; the search had not come to rest when it was stopped" if iterating else ""),
        f"{result.moved_mm:.1f} mm",
        f"at most {limit:.0f} mm",
        _outcome(result.moved_mm <= limit and not iterating),
    )


def _geometry(result: RegistrationResult) -> Check:
    determined = bool(np.isfinite(result.covariance).all())
    return Check(
        "Every direction determined",
        "whether the similarity falls off in all six directions of the pose",
        "yes" if determined else "no",
        "yes",
        _outcome(determined),
    )


def _at_most(
    name: str, measures: str, value: float | None, limit: float, *, unknown: str = "not determined"
) -> Check:
    """Build the check of a distance against its largest value; an infinite limit is none."""
    if value is None:
        return Check(name, measures, "", "", Outcome.NOT_CHECKED)
    if not math.isfinite(value):
        return Check(name, measures, unknown, _limit(limit), Outcome.FAILED)
    text = f"{value:.2f} mm"
    if math.isinf(limit):
        return Check(name, measures, text, "", Outcome.SHOWN)
    return Check(name, measures, text, _limit(limit), _outcome(value <= limit))


def _limit(limit: float) -> str:
    return "must be known" if math.isinf(limit) else f"at most {round(limit, 2):g} mm"


def _outcome(passed: bool) -> Outcome:
    return Outcome.PASSED if passed else Outcome.FAILED
