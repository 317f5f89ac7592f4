"""A pose must agree with touched landmarks at first, and with itself afterwards."""

import numpy as np
import pytest

from dvf_ig.core import Rigid
from dvf_ig.replay.trust import Trust

CENTER = np.array([10.0, -20.0, 30.0])


def moved(mm: float) -> Rigid:
    return Rigid("mr", "tracker", np.eye(3), np.array([mm, 0.0, 0.0]))


def test_an_undisturbed_patient_is_followed() -> None:
    trust = Trust(CENTER, landmarks=moved(1.5))
    for mm in (0.0, 1.0, 2.2, 1.4):
        trust, reason = trust.judged(moved(mm))
        assert reason == ""
        assert trust.in_use is not None
        assert trust.in_use.translation_mm[0] == mm


@pytest.mark.parametrize("landmarks", [None, moved(3.0)])
def test_landmarks_are_asked_where_there_are_any(landmarks: Rigid | None) -> None:
    trust, reason = Trust(CENTER, landmarks).judged(moved(9.0))
    assert bool(reason) == (landmarks is not None)
    assert (trust.in_use is None) == (landmarks is not None)
    if landmarks is not None:
        assert "6.0 mm" in reason


def test_a_patient_who_moved_is_withheld_until_confirmed() -> None:
    trust, _ = Trust(CENTER, landmarks=moved(0.0)).judged(moved(0.0))
    trust, reason = trust.judged(moved(8.0))
    assert "moved by 8.0 mm" in reason
    assert trust.in_use is None
    trust, reason = trust.judged(moved(8.6))
    assert reason == ""
    assert trust.in_use is not None


def test_a_pose_that_wanders_stays_withheld() -> None:
    trust, _ = Trust(CENTER, landmarks=None).judged(moved(0.0))
    for mm in (5.0, 7.0, 9.0, 6.0):
        trust, reason = trust.judged(moved(mm))
        assert reason
        assert trust.in_use is None
