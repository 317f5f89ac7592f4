"""Beats that agree on another place are told from beats that scatter about the pose."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, InvalidInputError, Rigid
from dvf_ig.registration import BeatMeasurement, PoseChart, PoseEstimate, ShiftDetector
from dvf_ig.registration.tracking.shift_detector import WINDOW_BEATS

CENTER = np.array([10.0, -20.0, 30.0])
HOME = Rigid.from_rotation_vector([0.2, -0.1, 0.4], [5.0, 6.0, -7.0], "mr", "tracker")
BEAT_MM = np.array([1.5, 0.6, 0.5, 0.4, 0.9, 0.5])
"""Standard deviation per coordinate of a beat."""


def at(xi_mm: FloatArray, sigma_mm: float) -> PoseEstimate:
    return PoseEstimate(PoseChart(HOME, CENTER).pose(xi_mm), sigma_mm**2 * np.eye(6), CENTER, np.eye(6))


def beat(estimate: PoseEstimate, seen_mm: FloatArray, information: FloatArray) -> BeatMeasurement:
    """A beat that puts the heart `seen_mm` from home."""
    seen = PoseChart(HOME, CENTER).pose(seen_mm)
    return BeatMeasurement(
        pose=estimate.pose,
        best=seen,
        offset_information_mm=information @ PoseChart(estimate.pose, CENTER).coordinates(seen),
        information=information,
        similarity=0.5,
        best_similarity=0.6,
        log_likelihood_ratio=1.0,
        wrong_pose_log_ratio=10.0,
        moved_mm=1.0,
        overlap=1.0,
        evaluations=1,
    )


def statistics(shift_mm: FloatArray, seed: int, beats: int, known_mm: float = 0.3) -> list[float]:
    """The statistic after each beat; the pose is off by an error of its own, and stays."""
    rng = np.random.default_rng(seed)
    estimate, detector, found = at(known_mm * rng.normal(size=6), known_mm), ShiftDetector(), []
    for k in range(beats):
        seen = shift_mm + BEAT_MM * rng.normal(size=6)
        detector = detector.after(0.8 * k, estimate, beat(estimate, seen, np.diag(BEAT_MM**-2.0)))
        assert detector.test is not None
        found.append(detector.test.statistic)
    return found


def test_one_beat_of_a_still_patient_is_chi_squared_of_six_degrees() -> None:
    drawn = np.array([statistics(np.zeros(6), seed, 1)[0] for seed in range(600)])
    for share in (0.5, 0.9, 0.99):
        assert np.mean(drawn > chi2.ppf(share, 6)) == pytest.approx(1 - share, abs=0.03)


def test_the_worst_window_exceeds_a_limit_no_more_often_than_the_windows_together() -> None:
    limit = float(chi2.ppf(0.995, 6))
    drawn = [statistics(np.zeros(6), seed, WINDOW_BEATS)[-1] > limit for seed in range(600)]
    assert np.mean(drawn) < WINDOW_BEATS * 0.005


def test_beats_together_find_a_shift_that_each_of_them_lets_pass() -> None:
    shift, limit = np.array([0, 0, 0, 1.8, 2.2, 1.5]), 34.0
    first = [statistics(shift, seed, 6) for seed in range(60)]
    assert np.mean([found[0] > limit for found in first]) < 0.5
    assert np.mean([found[5] > limit for found in first]) > 0.97


def test_a_direction_that_beats_do_not_observe_adds_nothing() -> None:
    information = np.diag([0.0, 0.0, 0.0, 4.0, 4.0, 4.0])
    estimate = at(np.zeros(6), 0.3)
    seen = np.array([30.0, 0, 0, 1.0, 0, 0])
    found = ShiftDetector().after(7.0, estimate, beat(estimate, seen, information)).test
    assert found is not None
    assert found.statistic == pytest.approx(1.0 / (0.25 + 0.09), rel=1e-6)
    assert (found.since_s, found.beats) == (7.0, 1)


def test_a_pose_that_follows_a_drift_is_compared_with_the_one_before() -> None:
    """The pose goes along with every beat; the one of WINDOW_BEATS beats ago shows the way it went."""
    detector, information = ShiftDetector(), np.eye(6) / 0.5**2
    for k in range(20):
        estimate = at(np.array([0, 0, 0, 0.6 * k, 0, 0]), 0.3)
        seen = np.array([0, 0, 0, 0.6 * k + 0.6, 0, 0])
        detector = detector.after(float(k), estimate, beat(estimate, seen, information))
    found = detector.test
    assert found is not None
    assert len(detector.compared) == WINDOW_BEATS
    assert found.statistic > 34.0
    assert found.beats > 3
    assert found.distance_mm > 1.5


def after_quiet(scatter: float, seed: int, beats: int, *, in_use: bool = True) -> ShiftDetector:
    """Beats of a still heart that scatter so many times further than their information promises."""
    rng, estimate, detector = np.random.default_rng(seed), at(np.zeros(6), 0.1), ShiftDetector()
    for k in range(beats):
        seen = scatter * BEAT_MM * rng.normal(size=6)
        told = beat(estimate, seen, np.diag(BEAT_MM**-2.0))
        detector = detector.after(0.8 * k, estimate, told, in_use=in_use)
    return detector


def test_beats_that_scatter_further_than_they_promise_are_believed_less() -> None:
    wide = [after_quiet(2.0, seed, 45) for seed in range(20)]
    assert np.mean([found.test.statistic for found in wide if found.test is not None]) < 20.0
    assert np.mean([found.variance for found in wide]) == pytest.approx(3.6, abs=0.4)
    assert np.mean([after_quiet(0.8, seed, 45).variance for seed in range(20)]) < 1.05


def test_the_scatter_is_that_of_beats_before_the_window_at_a_pose_in_use() -> None:
    quiet = after_quiet(2.0, 1, 45)
    assert after_quiet(2.0, 1, 45, in_use=False).variance == 1.0
    assert quiet.restarted().variance == quiet.variance
    assert quiet.restarted().test is None
    estimate, shifted = at(np.zeros(6), 0.1), quiet
    for k in range(WINDOW_BEATS):
        shifted = shifted.after(50.0 + k, estimate, beat(estimate, np.full(6, 8.0), np.diag(BEAT_MM**-2.0)))
        assert shifted.variance < 1.3 * quiet.variance, "a shift does not hide itself"
    assert shifted.test is not None
    assert shifted.test.statistic > 300.0


def test_beats_without_information_say_nothing() -> None:
    estimate = at(np.zeros(6), 0.1)
    found = ShiftDetector().after(0.0, estimate, beat(estimate, np.full(6, 8.0), np.zeros((6, 6)))).test
    assert found is not None
    assert found.statistic == 0.0


def test_a_registration_that_says_anew_how_shape_pulls_images_aside_is_no_shift() -> None:
    """Images go on matching at home; the pose is said to lie 3 mm from there from the fifth beat on."""
    detector, information = ShiftDetector(), np.eye(6) / 0.5**2
    aside = PoseChart(HOME, CENTER).pose(np.array([0, 0, 0, 0, 3.0, 0]))
    for k in range(8):
        pose = HOME if k < 4 else aside
        covariance = 0.1**2 * np.eye(6) / np.array([HEART_RADIUS_MM] * 3 + [1.0] * 3) ** 2
        estimate = PoseEstimate.from_registration(pose, covariance, covariance, CENTER, HOME)
        told = beat(at(np.zeros(6), 0.1), np.zeros(6), information).of(estimate, 0.0)
        detector = detector.after(float(k), estimate, told)
    assert detector.test is not None
    assert detector.test.statistic < 1e-6


WRONG = st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e300])


@given(wrong=WRONG, place=st.sampled_from(["information", "offset", "begin", "covariance", "ratio"]))
def test_numbers_that_are_none_are_refused_and_change_nothing(wrong: float, place: str) -> None:
    estimate, information = at(np.zeros(6), 0.3), np.diag(BEAT_MM**-2.0)
    good = beat(estimate, BEAT_MM, information)
    detector = ShiftDetector().after(0.0, estimate, good)
    calls: dict[str, Callable[[], object]] = {
        "begin": lambda: detector.after(wrong, estimate, good),
        "covariance": lambda: detector.after(
            0.8, replace(estimate, covariance_mm2=np.full((6, 6), wrong)), good
        ),
        "information": lambda: replace(good, information=np.full((6, 6), wrong)),
        "offset": lambda: replace(good, offset_information_mm=np.full(6, wrong)),
        "ratio": lambda: replace(good, wrong_pose_log_ratio=wrong),
    }
    with pytest.raises(InvalidInputError):
        calls[place]()


@settings(max_examples=30)
@given(exponent=st.floats(-12.0, 12.0), seed=st.integers(0, 9))
def test_the_statistic_of_any_allowed_beat_is_a_number(exponent: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(6, 6))
    information = factor @ factor.T
    information *= 10.0**exponent / np.abs(information).max()
    estimate, detector = at(np.zeros(6), 0.3), ShiftDetector()
    for k in range(WINDOW_BEATS + 2):
        told = replace(beat(estimate, np.zeros(6), information), offset_information_mm=information[0] / 6)
        detector = detector.after(0.8 * k, estimate, told)
        assert detector.test is not None
        assert np.isfinite([detector.test.statistic, detector.test.distance_mm, detector.variance]).all()
