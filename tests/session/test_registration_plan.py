"""Landmarks touched one by one: a fit from three on, a prior from five on, none of before a suspension.

Points touched on the surface before likewise count until then.
"""

import numpy as np
import pytest
from toy_session import HOME

from dvf_ig.core import FloatArray, Points, TouchedPoints, Warp
from dvf_ig.core.space.warp import knots
from dvf_ig.registration.start import LEAST_SIGMA_MM, MIN_FOR_PRIOR
from dvf_ig.session import Landmark
from dvf_ig.session.pose_states import NoPose
from dvf_ig.session.pose_transition import RegisterNext
from dvf_ig.session.registration_plan import RegistrationPlan, TouchedLandmarks

POINTS = np.array(
    [[40.0, 0.0, 0.0], [0.0, 35.0, 5.0], [0.0, -10.0, 50.0], [-30.0, 5.0, 8.0], [5.0, -40.0, 9.0]]
)


def touched(k: int, off_mm: FloatArray | None = None, name: str | None = None) -> Landmark:
    tracker = HOME.inverse().apply_array(POINTS[k : k + 1])[0]
    return Landmark(float(k), name or f"point {k}", POINTS[k], tracker + (0.0 if off_mm is None else off_mm))


def test_three_points_give_a_fit_and_five_a_prior() -> None:
    landmarks = TouchedLandmarks()
    for k in range(5):
        assert (landmarks.fit is None) == (k < 3)
        assert landmarks.prior is None
        landmarks = landmarks.touched(touched(k))
    assert landmarks.fit is not None
    np.testing.assert_allclose(landmarks.fit.matrix, HOME.matrix, atol=1e-9)
    assert MIN_FOR_PRIOR == 5
    assert landmarks.prior is not None
    assert landmarks.prior.sigma_mm == LEAST_SIGMA_MM


def test_a_change_of_shape_takes_landmarks_along() -> None:
    origin = np.full(3, -100.0)
    places = knots(origin, 200.0 / 12)
    m_mm = 6.0 * np.exp(-0.5 * ((places - POINTS[0]) ** 2).sum(axis=1, keepdims=True) / 30.0**2)
    warp = Warp.through("mr", origin, 200.0 / 12, m_mm * np.array([[0.6, 0.8, 0.0]]), np.ones(len(places)))
    landmarks = TouchedLandmarks()
    assert landmarks.fit_through(warp) is None
    for k, now in enumerate(warp.patient_places(POINTS)):
        landmarks = landmarks.touched(Landmark(0.0, f"point {k}", POINTS[k], HOME.inverse().apply_array(now)))
    found = landmarks.fit_through(warp)
    assert found is not None
    assert landmarks.fit is not None
    np.testing.assert_allclose(found.matrix, HOME.matrix, atol=1e-6)
    assert np.abs(landmarks.fit.matrix - HOME.matrix).max() > 0.5
    assert landmarks.fit_through(None) is landmarks.fit


def test_a_point_that_is_touched_again_replaces_the_older() -> None:
    landmarks = TouchedLandmarks()
    landmarks = landmarks.touched(touched(0, np.array([9.0, 0.0, 0.0])))
    for k in (1, 2, 0):
        landmarks = landmarks.touched(touched(k))
    assert landmarks.fit is not None
    np.testing.assert_allclose(landmarks.fit.matrix, HOME.matrix, atol=1e-9)


def test_points_on_one_line_are_no_fit_yet() -> None:
    landmarks = TouchedLandmarks()
    for k in range(3):
        on_line = np.array([10.0 * k, 5.0 * k, 0.0])
        landmarks = landmarks.touched(Landmark(0.0, f"point {k}", on_line, on_line))
    assert landmarks.fit is None
    assert landmarks.prior is None
    landmarks = landmarks.touched(
        Landmark(0.0, "off the line", np.array([0.0, 30.0, 5.0]), np.array([0.0, 30.0, 5.0]))
    )
    assert landmarks.fit is not None
    np.testing.assert_allclose(landmarks.fit.matrix, np.eye(4), atol=1e-9)


def test_after_a_suspension_only_points_touched_since_count() -> None:
    landmarks = TouchedLandmarks()
    for k in range(5):
        landmarks = landmarks.touched(touched(k, np.array([5.0, 0.0, 0.0])))
    landmarks = landmarks.since(np.inf)
    assert landmarks.fit is None
    assert landmarks.prior is None
    for k in range(3):
        landmarks = landmarks.touched(touched(k))
    assert landmarks.fit is not None
    assert landmarks.fit.apply_array(touched(4).tracker_mm[None])[0] == pytest.approx(POINTS[4], abs=1e-9)


def test_touched_surface_points_count_until_the_patient_may_have_moved() -> None:
    points = TouchedPoints(Points("tracker", POINTS), 0.0)
    plan = RegistrationPlan(HOME, points)
    plan.begin(1.0)
    first = plan.request(9.0, NoPose(), ())
    plan.change(RegisterNext(12.0))
    again = plan.request(12.0, NoPose(), ())
    plan.change(RegisterNext(15.0, forget_landmarks=True))
    moved = plan.request(15.0, NoPose(), ())
    assert first is not None
    assert again is not None
    assert moved is not None
    assert first.touched is again.touched is points
    assert moved.touched is None
