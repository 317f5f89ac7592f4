"""Landmarks give a start with its residuals; RAS taken for LPS is refused there, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
from toy_ball import ball_model
from toy_heart import toy_pose

from dvf_ig.core import DvfModel, InvalidInputError, Landmarks, Mesh, Points, Rigid
from dvf_ig.registration.start import FLIP, require_on_model, require_unflipped, start_from_landmarks

POSE = Rigid.from_rotation_vector([0.3, -0.5, 0.8], [60.0, -30.0, 12.0], "mr", "tracker")
NAMES = tuple(f"p{k}" for k in range(6))


def lump() -> DvfModel:
    """A body of three different half-axes beside the flip's axis."""
    turns = np.random.default_rng(1).standard_normal((400, 3))
    outline = turns / np.linalg.norm(turns, axis=1, keepdims=True) * [30.0, 20.0, 50.0] + [15.0, -8.0, 40.0]
    surface = Mesh("mr", outline, np.array([[0, 1, 2]]))
    model = ball_model()
    caps = (np.zeros(1, dtype=np.bool_),) * model.phases
    return replace(model, reference=(surface,) * model.phases, reference_caps=caps)


def marked() -> Landmarks:
    """Points on its surface at end-diastole."""
    return Landmarks(NAMES, Points("mr", lump().reference[0].vertices_mm[::70][:6]))


def flipped(landmarks: Landmarks) -> Landmarks:
    return replace(landmarks, points=Points(landmarks.frame, FLIP * landmarks.points.xyz_mm))


def test_marked_landmarks_in_ras_are_refused() -> None:
    require_on_model(marked(), lump())
    with pytest.raises(InvalidInputError, match="with x and y reversed: the file holds RAS"):
        require_on_model(flipped(marked()), lump())


def test_landmarks_that_are_far_from_the_model_either_way_are_no_matter_of_axes() -> None:
    far = Points("mr", marked().points.xyz_mm + np.array([0.0, 0.0, 400.0]))
    require_on_model(Landmarks(NAMES, far), lump())


@pytest.mark.parametrize("side", ["before", "after", "both"])
def test_a_start_pose_in_ras_is_refused(side: str) -> None:
    touched = Landmarks(NAMES, Points("tracker", POSE.inverse().apply_array(marked().points.xyz_mm)))
    coarse = POSE.perturbed_left([0.1, 0.0, 0.1], [8.0, -5.0, 4.0], np.zeros(3))
    require_unflipped(coarse, marked(), touched)
    flip = Rigid("mr", "mr", np.diag(FLIP), np.zeros(3))
    before = Rigid("tracker", "tracker", np.diag(FLIP), np.zeros(3))
    wrong = {"before": coarse @ before, "after": flip @ coarse, "both": flip @ coarse @ before}[side]
    with pytest.raises(InvalidInputError, match="the start pose puts the touched landmarks"):
        require_unflipped(wrong, marked(), touched)


def test_two_landmarks_tell_nothing() -> None:
    two = Landmarks(NAMES[:2], Points("tracker", np.zeros((2, 3))))
    require_unflipped(POSE, marked(), two)


def test_landmark_start_recovers_the_pose_and_reports_residuals() -> None:
    names = ("apex", "rv", "aorta", "laa")
    mr = np.array([[0.0, 0, 0], [60, 0, 10], [0, 50, 20], [10, -20, 70]])
    tracker = toy_pose().inverse().apply_array(mr)
    start = start_from_landmarks(
        Landmarks(names, Points("mr", mr)), Landmarks(names[::-1], Points("tracker", tracker[::-1]))
    )
    np.testing.assert_allclose(start.mr_from_tracker.matrix, toy_pose().matrix, atol=1e-9)
    assert start.residuals_mm.max() < 1e-9
    few = Landmarks(("apex", "x", "y"), Points("tracker", tracker[:3]))
    with pytest.raises(InvalidInputError, match="share 1 landmark names"):
        start_from_landmarks(Landmarks(names, Points("mr", mr)), few)
