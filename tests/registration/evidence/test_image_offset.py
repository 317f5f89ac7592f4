"""A probe calibration that was wrong, found by the views of the heart alone."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import FloatArray, Landmarks, Points, Rigid, Warp
from dvf_ig.core.space.warp import knots
from dvf_ig.registration import (
    LandmarkPrior,
    Lc2,
    PoseChart,
    ProbePoses,
    SliceSet,
    channels_from_mr,
    fit_image_offset,
    prior_from_landmarks,
    target_errors_mm,
)
from dvf_ig.registration.evidence.image_offset import ImageOffset, shape_log_ratio
from dvf_ig.registration.lc2.optimise import OptimiserOptions, optimise

PITCH_MM = 3.0
MIDDLE_MM = np.array([65.0, 65.0, 0.0])
STEP_MM = np.array([2.0, -1.5, 1.0, 3.0, 2.0, -2.5])


def probe_poses(slices: SliceSet, image: Rigid) -> tuple[FloatArray, FloatArray]:
    """tracker_from_probe of each slice whose image lies at `image` in the probe's frame."""
    across = slices.frame_from_pixel[:, :, :2] / PITCH_MM
    turned = np.concatenate([across, np.cross(across[:, :, 0], across[:, :, 1])[:, :, None]], axis=2)
    rotations = turned @ image.rotation.T
    return rotations, slices.frame_from_pixel[:, :, 2] - rotations @ image.translation_mm


def seen_with(step_mm: FloatArray) -> tuple[SliceSet, ProbePoses]:
    """Slices placed by a calibration that is `step_mm` off."""
    true = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(50), pitch_mm=PITCH_MM, speckle=0.2)
    image = Rigid.from_rotation_vector([0.3, 0.1, -0.2], [10.0, 5.0, 80.0], "probe", "image")
    middle_mm = image.apply_array(MIDDLE_MM)
    rotations, shifts_mm = probe_poses(true, image)
    wrong = PoseChart(image, middle_mm).pose(step_mm)
    turned = rotations @ wrong.rotation
    placed = np.concatenate([PITCH_MM * turned[:, :, :2], np.zeros((len(true), 3, 1))], axis=2)
    placed[:, :, 2] = rotations @ wrong.translation_mm + shifts_mm
    return replace(true, frame_from_pixel=placed), ProbePoses(
        rotations, shifts_mm, wrong, wrong.apply_array(MIDDLE_MM)
    )


def test_the_calibration_that_the_views_fit_is_found() -> None:
    """Wrong, it costs 3.8 mm; with 3 mm pixels, speckle and prior a fifth of that may remain."""
    found, error_mm = fitted(STEP_MM)
    assert found.moved_mm == pytest.approx(np.linalg.norm(STEP_MM[3:]), abs=0.8)
    assert found.turned_deg == pytest.approx(2.6, abs=0.4)
    assert error_mm < 0.8
    assert found.log_likelihood_ratio > 1.0


def test_a_right_calibration_stays() -> None:
    found, error_mm = fitted(np.zeros(6))
    assert found.moved_mm < 0.4
    assert found.turned_deg < 0.6
    assert error_mm < 0.5
    assert 0.0 <= found.log_likelihood_ratio < 0.1


def test_landmarks_show_a_wrong_calibration_sooner_than_the_views() -> None:
    rng = np.random.default_rng(3)
    marked_mm = CENTER_MM + rng.uniform(-45, 45, (8, 3))
    touched_mm = toy_pose().inverse().apply_array(marked_mm) + rng.normal(0, 0.5, (8, 3))
    names = tuple("abcdefgh")
    mr, tracker = Landmarks(names, Points("mr", marked_mm)), Landmarks(names, Points("tracker", touched_mm))
    landmarks = prior_from_landmarks(mr, tracker)
    assert fitted(np.zeros(6), landmarks)[0].log_likelihood_ratio < 0.1
    alone, both = fitted(1.5 * STEP_MM)[0], fitted(1.5 * STEP_MM, landmarks)[0]
    assert both.log_likelihood_ratio > 1.5 * alone.log_likelihood_ratio


def test_few_landmarks_must_contradict_a_calibration_more_plainly() -> None:
    """Quantiles of F(6, 9) and F(6, 18), of tables."""
    offset = ImageOffset(toy_pose(), toy_pose(), 4.0, 2.0, log_likelihood_ratio=14.0)
    assert replace(offset, landmarks=5).limit == pytest.approx(3 * 5.80, abs=0.02)
    assert replace(offset, landmarks=8).limit == pytest.approx(3 * 4.01, abs=0.02)
    assert "touched landmarks" in replace(offset, landmarks=8).sentence


def test_a_change_of_shape_explains_views_as_the_motion_that_it_is() -> None:
    """A pull-back by one step everywhere is another pose."""
    slices, _ = seen_with(np.zeros(6))
    metric = Lc2(slices, channels_from_mr(toy_mr(), smoothing_mm=1.0), patch_mm=21.0, pitch_mm=PITCH_MM)
    step_mm = np.array([3.0, -2.0, 2.5])
    moved = Rigid("mr", "tracker", toy_pose().rotation, toy_pose().translation_mm + step_mm)
    low_mm, knot_mm = CENTER_MM - 120.0, 20.0
    places = knots(low_mm, knot_mm)
    warp = Warp.through("mr", low_mm, knot_mm, np.tile(step_mm, (len(places), 1)), np.ones(len(places)))
    assert shape_log_ratio(metric, toy_pose(), moved, warp, CENTER_MM) == pytest.approx(0.0, abs=1e-3)
    gain = shape_log_ratio(metric, moved, moved, warp, CENTER_MM)
    assert gain > 2.0
    offset = ImageOffset(toy_pose(), toy_pose(), 4.0, 2.0, log_likelihood_ratio=9.0)
    assert offset.suspicious
    assert not replace(offset, shape_log_ratio=5.0).suspicious
    assert replace(offset, log_likelihood_ratio=6.0, shape_log_ratio=-2.0).suspicious


def fitted(step_mm: FloatArray, landmarks: LandmarkPrior | None = None) -> tuple[ImageOffset, float]:
    """From the pose that fits best with the calibration as given; its mean error in mm."""
    slices, probe = seen_with(step_mm)
    model = channels_from_mr(toy_mr(), smoothing_mm=1.0)
    metric = partial(Lc2, model=model, patch_mm=21.0, pitch_mm=PITCH_MM)
    start = optimise(metric(slices), toy_pose(), CENTER_MM, None, OptimiserOptions(40, 4.0, 0.02)).pose
    found = fit_image_offset(probe, metric(slices), start, CENTER_MM, landmarks)
    targets = Points("mr", CENTER_MM + np.random.default_rng(1).uniform(-40, 40, (27, 3)))
    return found, float(target_errors_mm(found.pose, toy_pose(), targets).mean())
