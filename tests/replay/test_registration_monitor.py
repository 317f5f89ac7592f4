"""A pose must agree with touched landmarks at first, and with every heart beat afterwards."""

import numpy as np
import pytest

from dvf_ig.core import Rigid
from dvf_ig.registration import BeatMeasurement, PoseEstimate
from dvf_ig.replay.registration_monitor import CONFIRMING, EXPLAINED, SURPRISE, Trust

CENTER = np.array([10.0, -20.0, 30.0])


def at(mm: float, sigma_mm: float = 0.4) -> PoseEstimate:
    pose = Rigid("mr", "tracker", np.eye(3), np.array([mm, 0.0, 0.0]))
    return PoseEstimate(pose, sigma_mm**2 * np.eye(6), CENTER)


def look(surprise: float, *, off_mm: float = 0.0) -> BeatMeasurement:
    """A beat that would have the pose `off_mm` further along x, seen as well as the pose is known."""
    information = np.eye(6) / 0.4**2
    offset = np.array([0, 0, 0, off_mm, 0, 0])
    pose = at(0.0).pose
    return BeatMeasurement(
        pose=pose,
        best=at(off_mm).pose,
        offset_information_mm=information @ offset,
        information=information,
        similarity=0.5,
        best_similarity=0.6,
        log_likelihood_ratio=surprise,
        moved_mm=off_mm,
        overlap=1.0,
        evaluations=1,
    )


def guided(mm: float = 0.0) -> Trust:
    trust, reason = Trust(CENTER, landmarks=None).registered(at(mm), 0)
    assert "waits for heart beats" in reason
    for _ in range(CONFIRMING):
        assert trust.guiding is None
        trust = trust.saw(look(1.0))
    assert trust.guiding is not None
    return trust


def along(trust: Trust) -> float:
    assert trust.guiding is not None
    return float(trust.guiding.pose.translation_mm[0])


def test_a_first_pose_guides_once_beats_confirm_it() -> None:
    assert along(guided(1.0)) == pytest.approx(1.0)


def test_a_contradicted_registration_is_dropped_and_the_next_needs_more() -> None:
    trust, _ = Trust(CENTER, landmarks=None).registered(at(0.0), 0)
    for surprise in (1.0, 1.0, EXPLAINED + 0.1):
        trust = trust.saw(look(surprise))
    assert trust.on_trial is None
    trust, _ = trust.registered(at(0.5), 0)
    for _ in range(2 * CONFIRMING):
        assert trust.guiding is None
        trust = trust.saw(look(1.0))
    assert trust.guiding is not None
    assert trust.confirming == CONFIRMING


@pytest.mark.parametrize("landmarks", [None, at(3.0).pose])
def test_landmarks_are_asked_where_there_are_any(landmarks: Rigid | None) -> None:
    trust, reason = Trust(CENTER, landmarks).registered(at(9.0), 0)
    assert (trust.candidate is None) == (landmarks is not None)
    assert ("6.0 mm" in reason) == (landmarks is not None)


def test_landmarks_are_not_asked_again_after_a_patient_moved() -> None:
    trust, _ = Trust(CENTER, landmarks=at(0.0).pose).registered(at(0.5), 0)
    for _ in range(CONFIRMING):
        trust = trust.saw(look(1.0))
    trust, reason = trust.saw(look(20.0)).registered(at(9.0), 0)
    assert "waits for heart beats" in reason
    assert trust.candidate is not None


def test_a_beat_that_is_not_explained_stops_guidance_at_once() -> None:
    trust = guided().saw(look(SURPRISE + 0.1, off_mm=8.0))
    assert trust.guiding is None
    assert trust.on_trial is not None
    assert trust.on_trial.pose.translation_mm[0] == pytest.approx(0.0, abs=1e-9)
    assert guided().saw(look(SURPRISE - 0.1)).guiding is not None


def test_a_false_alarm_ends_when_beats_explain_the_pose_again() -> None:
    trust = guided().saw(look(SURPRISE + 1.0))
    for _ in range(CONFIRMING):
        assert trust.guiding is None
        trust = trust.saw(look(0.5))
    assert along(trust) == pytest.approx(0.0, abs=1e-9)


def test_a_patient_who_moved_is_found_and_confirmed() -> None:
    trust, reason = guided().saw(look(20.0, off_mm=8.0)).registered(at(8.0), 0)
    assert "waits for heart beats" in reason
    for _ in range(CONFIRMING):
        trust = trust.saw(look(1.0))
    assert along(trust) == pytest.approx(8.0)


def test_a_registration_elsewhere_stops_guidance_until_confirmed() -> None:
    trust, reason = guided().registered(at(3.0), 0)
    assert "moved by 3.0 mm" in reason
    assert trust.guiding is None
    for _ in range(CONFIRMING):
        trust = trust.saw(look(1.0))
    assert along(trust) == pytest.approx(3.0)


def test_beats_and_registrations_move_the_pose_by_their_weight() -> None:
    """Equal covariances meet half-way; an older registration counts for less."""
    trust = Trust(CENTER, None, belief=at(0.0), doubtful=False)
    now, reason = trust.registered(at(1.0), 0)
    assert reason == ""
    assert along(now) == pytest.approx(0.5)
    assert 0.0 < along(trust.registered(at(1.0), 20)[0]) < 0.5
    assert 0.5 < along(trust.saw(look(2.0, off_mm=1.0))) < 0.55
