"""Known-transform recovery on the toy heart, its evidence, and what must be refused."""

import importlib
from dataclasses import replace
from functools import lru_cache
from time import perf_counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from followed_shape import followed_shape
from stub_registration import any_result
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import Landmarks, Points, Rigid, Stop, VolumeSeries, Warp, summarise_errors
from dvf_ig.registration import (
    BLOOD,
    WALL,
    HeartChannels,
    LandmarkPrior,
    Level,
    RegistrationOptions,
    RegistrationResult,
    ShapeChange,
    UltrasoundImages,
    channels_from_mr,
    pose_difference,
    prior_from_landmarks,
    register,
    start_from_landmarks,
    target_errors_mm,
    target_from_labels,
)
from dvf_ig.registration.boundary.points import BoundaryPoints
from dvf_ig.registration.coverage import Coverage
from dvf_ig.registration.shape.change import Halves

QUICK = RegistrationOptions(starts=4)
register_module = importlib.import_module("dvf_ig.registration.register")
PITCHES_MM = (3.0, 1.5)


def _register(
    levels: tuple[Level, Level],
    start: Rigid,
    *,
    seed: int = 0,
    landmarks: LandmarkPrior | None = None,
    options: RegistrationOptions = QUICK,
) -> RegistrationResult:
    return register(
        UltrasoundImages(*levels, options=options),
        _heart(),
        start,
        rng=np.random.default_rng(seed),
        clock=perf_counter,
        landmarks=landmarks,
    )


@lru_cache(maxsize=1)
def _heart() -> HeartChannels:
    return HeartChannels(channels_from_mr(toy_mr(), smoothing_mm=1.0), CENTER_MM)


def _levels(speckle: float, *, matching: bool = True) -> tuple[Level, Level]:
    mr = toy_mr()
    pose = toy_pose()
    out = []
    for pitch in PITCHES_MM:
        slices = toy_slices(mr, pose, np.random.default_rng(50), pitch_mm=pitch, speckle=speckle)
        if not matching:
            noise = np.random.default_rng(9).random(slices.images.shape).astype(np.float32)
            slices = replace(slices, images=noise)
        out.append(Level(slices, pitch))
    return out[0], out[1]


def _displaced(mm: float, deg: float, seed: int) -> Rigid:
    rng = np.random.default_rng(seed)
    shift, turn = rng.normal(size=3), rng.normal(size=3)
    return toy_pose().perturbed_left(
        np.radians(deg) * turn / np.linalg.norm(turn), mm * shift / np.linalg.norm(shift), CENTER_MM
    )


def _tre(estimate: Rigid) -> np.ndarray:
    targets = Points("mr", CENTER_MM + np.random.default_rng(1).uniform(-40, 40, (27, 3)))
    return target_errors_mm(estimate, toy_pose(), targets)


def test_recovers_a_10_mm_8_degree_displacement() -> None:
    start = _displaced(10.0, 8.0, 1)
    result = _register(_levels(speckle=0.3), start)
    assert result.stop is Stop.CONVERGED
    assert _tre(start).mean() > 8
    # speckle of 0.3 per 1.5 mm pixel on 12 slices leaves about 0.2 mm; three times that is allowed
    assert _tre(result.target_from_source).mean() < 0.6
    assert result.similarity > result.start_similarity
    assert result.success_probability is None, "nothing was calibrated for toys"
    assert np.linalg.eigvalsh(result.covariance).min() > 0


def test_same_seed_same_bits() -> None:
    levels, options = _levels(speckle=0.3), RegistrationOptions(starts=1)
    poses = [
        _register(levels, _displaced(6, 4, 3), seed=5, options=options).target_from_source.matrix
        for _ in range(2)
    ]
    np.testing.assert_array_equal(poses[0], poses[1])


def test_same_bits_at_one_and_two_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    levels, options = _levels(speckle=0.3), RegistrationOptions(starts=1)
    results = []
    for threads in (1, 2):
        monkeypatch.setattr("dvf_ig.registration.lc2.lc2.thread_count", lambda n=threads: n)
        results.append(_register(levels, _displaced(6, 4, 3), seed=5, options=options))
    one, two = results
    np.testing.assert_array_equal(one.target_from_source.matrix, two.target_from_source.matrix)
    np.testing.assert_array_equal(one.covariance, two.covariance)
    assert one.evidence == two.evidence
    assert one.evidence.half_volume_mm is not None


def test_noise_instead_of_a_heart_is_not_called_a_success() -> None:
    result = _register(_levels(speckle=0.0, matching=False), _displaced(5, 3, 1))
    assert not result.stop.usable
    assert result.tre_bound_mm is None


def test_slices_beside_the_model_are_low_overlap() -> None:
    away = toy_pose().perturbed_left(np.zeros(3), [400.0, 0, 0], CENTER_MM)
    result = _register(_levels(speckle=0.3), away, options=RegistrationOptions(starts=1))
    assert result.stop is Stop.LOW_OVERLAP


def _eight_landmarks(pose: Rigid) -> LandmarkPrior:
    """Eight landmarks that were touched rightly, to 2 mm."""
    rng = np.random.default_rng(3)
    mr = 40.0 * rng.normal(size=(8, 3))
    tracker = pose.inverse().apply_array(mr) + 2.0 * rng.normal(size=(8, 3))
    names = tuple("abcdefgh")
    prior = prior_from_landmarks(
        Landmarks(names, Points("mr", mr)), Landmarks(names, Points("tracker", tracker))
    )
    assert prior is not None
    return prior


@pytest.mark.parametrize("touched", [False, True])
@pytest.mark.parametrize("away_mm", [80.0, 160.0, 1000.0])
def test_slices_at_the_edge_of_the_model_or_far_from_it_are_refused(away_mm: float, touched: bool) -> None:
    """As with the poses of another marker: few pixels within the model, or none."""
    levels = _levels(speckle=0.3)
    for shift in ([away_mm, 0, 0], [0, -away_mm, 0], [0, 0, away_mm]):
        away = toy_pose().perturbed_left(np.zeros(3), shift, CENTER_MM)
        prior = _eight_landmarks(away) if touched else None
        result = _register(levels, away, landmarks=prior, options=RegistrationOptions(starts=1))
        assert not result.stop.usable
        told = "the probe's and not the tool's" in result.sentence
        assert told is (result.stop is Stop.LOW_OVERLAP)
        assert told or away_mm < 1000.0


@pytest.mark.parametrize("touched", [False, True])
@pytest.mark.parametrize("part", ["images", "masks"])
def test_slices_that_show_nothing_are_refused(part: str, touched: bool) -> None:
    """Black images, and a sector without a pixel."""
    coarse, fine = (
        replace(level, slices=replace(level.slices, **{part: np.zeros_like(getattr(level.slices, part))}))
        for level in _levels(speckle=0.3)
    )
    prior = _eight_landmarks(toy_pose()) if touched else None
    result = _register((coarse, fine), toy_pose(), landmarks=prior, options=RegistrationOptions(starts=1))
    assert not result.stop.usable


def test_target_error_of_a_known_shift_composes_and_is_frame_invariant() -> None:
    truth = toy_pose()
    shifted = Rigid("mr", "tracker", truth.rotation, truth.translation_mm + np.array([0, 3.0, 4.0]))
    far = Points("mr", np.random.default_rng(0).normal(2000, 50, (10, 3)))
    np.testing.assert_allclose(target_errors_mm(shifted, truth, far), 5.0, atol=1e-9)
    turn, shift = pose_difference(shifted, truth, CENTER_MM)
    assert turn == pytest.approx(0.0, abs=1e-5)
    np.testing.assert_allclose(shift, [0, 3, 4], atol=1e-9)
    summary = summarise_errors(np.array([1.0, 2.0, 3.0, 10.0]))
    assert (summary.median, summary.max, summary.n) == (2.5, 10.0, 4)


def test_slices_that_show_none_of_the_models_boundary_end_in_disagreement() -> None:
    mr = toy_mr()
    labels = VolumeSeries(mr.grid, np.where(mr.values > 230, BLOOD, WALL).astype(np.uint8), mr.timing)
    rows, numbers = np.zeros((0, 3)), np.zeros(0)
    none = BoundaryPoints("tracker", rows, rows, rows, numbers, numbers)
    heart = replace(_heart(), surface=target_from_labels(labels, mr.timing.fractions))
    images = UltrasoundImages(*_levels(0.1), none, options=QUICK)
    result = register(
        images, heart, _displaced(3.0, 2.0, 1), rng=np.random.default_rng(0), clock=perf_counter
    )
    assert result.stop is Stop.DISAGREEMENT
    assert result.evidence.boundary_mm == np.inf
    assert _tre(result.target_from_source).mean() < 1.0


def _touched(noise_mm: float, count: int = 7) -> tuple[Landmarks, Landmarks]:
    rng = np.random.default_rng(11)
    mr = CENTER_MM + rng.uniform(-45, 45, (count, 3))
    tracker = toy_pose().inverse().apply_array(mr) + noise_mm * rng.normal(size=mr.shape)
    names = tuple(f"p{i}" for i in range(count))
    return Landmarks(names, Points("mr", mr)), Landmarks(names, Points("tracker", tracker))


def test_landmark_prior_knows_its_own_spread() -> None:
    prior = prior_from_landmarks(*_touched(1.7, count=200))
    assert prior is not None
    assert prior.sigma_mm == pytest.approx(1.7, rel=0.1)
    dof = 3 * 200 - 6
    start = start_from_landmarks(*_touched(1.7, count=200)).mr_from_tracker
    assert prior.energy(start) == pytest.approx(dof / 2, rel=1e-6)
    assert prior_from_landmarks(*_touched(1.7, count=4)) is None


def test_landmarks_hold_the_pose_where_the_image_says_nothing() -> None:
    mr, tracker = _touched(0.2)
    start = start_from_landmarks(mr, tracker).mr_from_tracker
    prior = prior_from_landmarks(mr, tracker)
    result = _register(_levels(speckle=0.0, matching=False), start, landmarks=prior)
    assert _tre(result.target_from_source).mean() < 1.5
    assert result.stop is Stop.POOR_MATCH


@pytest.mark.parametrize(("off_mm", "stop"), [(3.0, Stop.CONVERGED), (6.0, Stop.DISAGREEMENT)])
def test_landmarks_elsewhere_rule_a_pose_out(off_mm: float, stop: Stop) -> None:
    elsewhere = toy_pose().perturbed_left(np.zeros(3), np.array([off_mm, 0.0, 0.0]), CENTER_MM)
    result = register_module.against_touched(
        _register(_levels(speckle=0.3), toy_pose()), lambda _: elsewhere, None
    )
    assert result.stop is stop
    assert result.landmarks_mm == pytest.approx(off_mm, abs=0.6)
    assert (result.tre_bound_mm, result.touched) == (None, None)
    named = "Check in this order: probe calibration" in result.sentence
    assert named is (stop is Stop.DISAGREEMENT)


@pytest.mark.parametrize(
    ("shared", "seen_mm", "stop"),
    [(0.2, 2.4, Stop.CONVERGED), (0.8, 2.4, Stop.CHANGED_SHAPE), (0.2, 4.5, Stop.CHANGED_SHAPE)],
)
def test_a_heart_of_another_shape_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, shared: float, seen_mm: float, stop: Stop
) -> None:
    warp = Warp("mr", np.zeros(3), 16.0, np.zeros((15, 15, 15, 4), np.float32))
    change = ShapeChange(
        followed_shape(warp), 3.0, 90.0, seen_mm, "left", 4.04, 0.3, shared, Halves(0.5, 0.4)
    )
    monkeypatch.setattr(register_module, "_change_of_shape", lambda problem, fused, coverage, touched: change)
    result = _register(_levels(speckle=0.3), toy_pose(), options=RegistrationOptions(starts=0))
    assert result.stop is stop
    assert result.shape is change
    words = "the left wall lies 4.0 mm further out (± 0.6)"
    assert (words in result.sentence) is (stop is Stop.CHANGED_SHAPE)
    assert words in change.sentence
    assert ("may be another patient's" in result.sentence) is (seen_mm > 3.5)
    off = replace(result, landmarks_mm=12.0).sentence
    assert ("check the probe calibration first" in off) is (stop is Stop.CHANGED_SHAPE)


@pytest.mark.parametrize("shared", [0.2, 0.8])
def test_landmarks_are_fitted_through_a_change_of_shape_that_is_followed(shared: float) -> None:
    warp = Warp("mr", np.zeros(3), 16.0, np.zeros((15, 15, 15, 4), np.float32))
    change = ShapeChange(followed_shape(warp), 3.0, 90.0, 1.4, "left", 4.0, 0.3, shared, Halves(0.5, 0.4))
    fits: dict[Warp | None, float] = {warp: 1.0, None: 6.0}

    def landmarks(through: Warp | None) -> Rigid:
        return pose.perturbed_left(np.zeros(3), np.array([fits[through], 0.0, 0.0]), CENTER_MM)

    pose = toy_pose()
    result = replace(any_result(), target_from_source=pose, center_mm=CENTER_MM, shape=change)
    checked = register_module.against_touched(result, landmarks, None)
    assert checked.landmarks_mm == pytest.approx(1.0 if shared < 0.7 else 6.0)
    assert (checked.stop is Stop.DISAGREEMENT) is (shared > 0.7)


@pytest.mark.parametrize("imaged", [0.6, 1.0])
@pytest.mark.parametrize("beyond", [-1.0, 1.0])
def test_a_part_of_a_heart_that_has_clearly_changed_is_refused_and_never_followed(
    monkeypatch: pytest.MonkeyPatch, beyond: float, imaged: float
) -> None:
    evidence = imaged * register_module.PART_EVIDENCE + beyond
    warp = Warp("mr", np.zeros(3), 16.0, np.zeros((15, 15, 15, 4), np.float32))
    found = ShapeChange(followed_shape(warp), 1.5, evidence, 2.4, "left", 4.0, 0.3, 0.2, Halves(0.5, 0.3))
    assert found.followed is not None
    monkeypatch.setattr(register_module, "change_of_shape", lambda *_: found)
    heart = SimpleNamespace(model=None)
    problem: Any = SimpleNamespace(boundary_at=lambda pose: "seen", heart=heart, center_mm=CENTER_MM)
    coverage = Coverage(imaged, np.full(3, np.nan), np.zeros((1, 3)))
    fused: Any = SimpleNamespace(boundary=SimpleNamespace(offset_mm=0.0), pose=toy_pose())
    change = register_module._change_of_shape(problem, fused, coverage, None)
    if beyond < 0.0:
        assert change is None, "breath-holds shift slices, which looks like a change"
        return
    assert change.followed is None
    assert "do not show how the rest has changed" in change.refusal
