"""A registration in words: every check with its limit, and the numbers of its JSON."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from followed_shape import followed_shape
from known_patient import registration
from toy_session import CENTER, HOME

from dvf_ig.core import Stop, Warp
from dvf_ig.registration import Evidence, RegistrationOptions, RegistrationResult, SurfaceDisagreement
from dvf_ig.registration.evidence.checks import VOLUME_LIMITS
from dvf_ig.registration.evidence.phase_offset import PhaseOffset
from dvf_ig.registration.shape.change import Halves, ShapeChange
from dvf_ig.replay.page.registration_checks import checks_of
from dvf_ig.replay.page.registration_page import ShownInput, registration_page
from dvf_ig.report.registration import Check, Outcome

START = HOME.perturbed_left(np.array([0.1, 0.0, 0.0]), np.array([0.0, 3.0, 0.0]), CENTER)


def good() -> RegistrationResult:
    return registration(HOME, CENTER)


def with_evidence(**evidence: object) -> RegistrationResult:
    return replace(good(), evidence=replace(good().evidence, **evidence))


def named(
    result: RegistrationResult,
    name: str,
    landmarks_mm: float | None = None,
    touched: SurfaceDisagreement | None = None,
) -> Check:
    checked = replace(result, landmarks_mm=landmarks_mm, touched=touched)
    (found,) = [check for check in checks_of(checked) if check.name == name]
    return found


def page(result: RegistrationResult, **shown: object) -> str:
    given = ShownInput(
        title="Registration of a toy",
        about="patient nobody",
        source_name="the tracker",
        target_name="the pre-operative image",
        anatomy="MR",
        remark="No grey-level MR was given.",
        planes=[],
        data=[("frames compared with the model", "48 of 50")],
    )
    given = replace(given, **shown)
    return registration_page(replace(result, start=START), given, Path("out/mr_from_tracker.tfm"), 7, "")


def test_what_does_not_exist_for_the_input_is_not_checked() -> None:
    outcomes = {check.name: check.outcome for check in checks_of(good())}
    not_checked = {name for name, outcome in outcomes.items() if outcome is Outcome.NOT_CHECKED}
    assert not_checked == {
        "Half-volumes",
        "Boundary and grey levels",
        "ECG and images",
        "Probe calibration",
        "Touched landmarks",
        "Touched surface",
    }
    assert outcomes["Parts of the cycle"] is Outcome.SHOWN
    assert outcomes["Overlap"] is outcomes["Interleaved halves"] is Outcome.PASSED
    assert named(with_evidence(phase_mm=None), "Parts of the cycle").outcome is Outcome.NOT_CHECKED


@pytest.mark.parametrize(
    ("name", "evidence", "value", "limit"),
    [
        ("Better than wrong poses", {"z_score": 3.7}, "3.7", "at least 3.8"),
        ("Interleaved halves", {"split_half_mm": 4.1}, "4.10 mm", "at most 4 mm"),
        ("Interleaved halves", {"split_half_mm": math.inf}, "not determined", "at most 4 mm"),
        ("Boundary and grey levels", {"boundary_mm": math.inf}, "no boundary seen", "must be known"),
    ],
)
def test_a_check_beyond_its_limit_failed(
    name: str, evidence: dict[str, float], value: str, limit: str
) -> None:
    check = named(with_evidence(**evidence), name)
    assert (check.value, check.limit, check.outcome) == (value, limit, Outcome.FAILED)


def test_a_check_fails_exactly_where_the_judge_refuses() -> None:
    """The worst ratio is above 1 where and only where one of the rows failed."""
    rng = np.random.default_rng(1)
    rows = ["Better than wrong poses", "Interleaved halves", "Parts of the cycle", "Half-volumes"]
    rows.append("Boundary and grey levels")
    refused = 0
    for limits in (RegistrationOptions().limits, VOLUME_LIMITS):
        for _ in range(200):
            evidence = Evidence(
                z_score=float(rng.uniform(3, 12)),
                split_half_mm=float(rng.choice([rng.uniform(0, 4.5), math.inf], p=[0.95, 0.05])),
                phase_mm=float(rng.uniform(0.01, 1.5)),
                half_volume_mm=None if rng.random() < 0.3 else float(rng.uniform(0, 3)),
                boundary_mm=None if rng.random() < 0.3 else float(rng.choice([1.0, 3.0, math.inf])),
            )
            result = replace(good(), evidence=evidence, options=RegistrationOptions(limits=limits))
            failed = any(named(result, row).outcome is Outcome.FAILED for row in rows)
            assert failed == (evidence.worst_test_ratio(limits) > 1.0)
            refused += failed
    assert 50 < refused < 350


def test_volumes_are_held_against_their_own_limits() -> None:
    result = replace(
        with_evidence(half_volume_mm=2.6, phase_mm=2.3), options=RegistrationOptions(limits=VOLUME_LIMITS)
    )
    assert named(result, "Half-volumes").outcome is Outcome.FAILED
    assert named(result, "Parts of the cycle").limit == "at most 2.2 mm"


@pytest.mark.parametrize(
    ("offset_s", "ratio", "passed"), [(0.3, 9.0, False), (0.3, 1.0, True), (0.01, 9.0, True)]
)
def test_a_late_ecg_needs_both_a_shift_and_evidence(offset_s: float, ratio: float, passed: bool) -> None:
    offset = PhaseOffset(offset_s, offset_s, ratio)
    check = named(with_evidence(phase_offset=offset), "ECG and images")
    assert check.value == f"{1000 * offset_s:.0f} ms (log-likelihood ratio {ratio:.1f})"
    assert check.outcome is (Outcome.PASSED if passed else Outcome.FAILED)


def test_landmarks_overlap_distance_and_geometry_have_their_rows() -> None:
    assert named(good(), "Touched landmarks", 3.9).outcome is Outcome.PASSED
    assert named(good(), "Touched landmarks", 4.1).outcome is Outcome.FAILED
    for median_mm, outcome in ((1.9, Outcome.PASSED), (2.1, Outcome.FAILED)):
        touched = SurfaceDisagreement(median_mm, 2.0123, np.full(30, median_mm))
        check = named(good(), "Touched surface", touched=touched)
        assert (check.value, check.limit, check.outcome) == (
            f"{median_mm:.2f} mm",
            "at most 2.01 mm",
            outcome,
        )
    assert named(replace(good(), overlap=0.34), "Overlap").outcome is Outcome.FAILED
    assert named(replace(good(), moved_mm=31.0), "Distance moved").outcome is Outcome.FAILED
    still_moving = named(replace(good(), stop=Stop.MAX_ITERATIONS), "Distance moved")
    assert still_moving.outcome is Outcome.FAILED
    assert "had not come to rest" in still_moving.measures
    open_pose = replace(good(), covariance=np.full((6, 6), np.nan))
    assert named(open_pose, "Every direction determined").outcome is Outcome.FAILED
    assert "not determined" in page(open_pose)


def test_checks_of_a_change_of_shape_refuse_a_large_one_and_leave_a_small_one_rigid() -> None:
    warp = Warp("mr", np.zeros(3), 16.0, np.zeros((15, 15, 15, 4), np.float32))
    halves, systole = Halves(0.8, 0.4), Halves(0.9, 0.6)
    small = ShapeChange(followed_shape(warp), 1.5, 90.0, 0.9, "left", 2.0, 0.3, 0.2, halves, systole)
    check = named(replace(good(), shape=small), "Systole")
    assert (check.value, check.limit, check.outcome) == ("0.60 mm", "at most 0.5 mm", Outcome.RIGID)
    assert named(replace(good(), shape=small), "Halves of the frames").outcome is Outcome.PASSED
    large = replace(small, seen_mm=1.2, halves=Halves(0.8, 1.4), phases=None)
    assert named(replace(good(), shape=large), "Halves of the frames").outcome is Outcome.FAILED
    assert named(replace(good(), shape=large), "Frames held out").outcome is Outcome.PASSED
    assert not [check for check in checks_of(replace(good(), shape=large)) if check.name == "Systole"]


def test_the_page_says_why_and_what_failed() -> None:
    text = page(good())
    assert "It converged, and passed all 5 checks that its kind of input allows." in text
    bad = with_evidence(split_half_mm=4.1).refused(Stop.DISAGREEMENT)
    text = page(bad)
    assert "✕ REFUSED" in text
    assert "Independent checks of the pose disagree; do not guide by it." in text
    assert "Failed: interleaved halves (4.10 mm, needed at most 4 mm)." in text
    assert "not stated for a refused pose" in text


def test_the_numbers_are_those_of_the_result() -> None:
    result = replace(good(), similarity=0.6123, start_similarity=0.4987, second_best=0.3219, moved_mm=12.34)
    text = page(result)
    for shown in (
        "0.499 at the start, 0.612 registered",
        "the best pose found elsewhere has 0.322",
        "12.3 mm, turned by 5.7°",
        "<td>1.00</td>",
        "below 2.0 mm, at 95 %",
        "shifts 0.40, 0.40, 0.40 mm; turns about these axes 0.57, 0.57, 0.57°",
        "weakest: 0.4 mm",
        "No grey-level MR was given.",
        "<td>frames compared with the model</td><td>48 of 50</td>",
        "<td>seed</td><td>7</td>",
        "mr_from_tracker.tfm and the .h5 file",
    ):
        assert shown in text
    for value in result.target_from_source.matrix[:3].ravel():
        assert f"<td>{value:.4f}</td>" in text
    assert "no other pose was found" in page(good())
