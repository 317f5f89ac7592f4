"""What was touched on the patient counts until the patient may have moved."""

import numpy as np

from dvf_ig.core import Points, Rigid, TouchedPoints
from dvf_ig.session.pose_states import NoPose
from dvf_ig.session.pose_transition import RegisterNext
from dvf_ig.session.registration_plan import RegistrationPlan


def test_touched_points_count_until_the_patient_may_have_moved() -> None:
    touched = TouchedPoints(Points("tracker", np.eye(3)), 0.0)
    plan = RegistrationPlan(Rigid.identity("mr", "tracker"), touched)
    plan.begin(1.0)
    first = plan.request(9.0, NoPose(), ())
    plan.change(RegisterNext(12.0))
    again = plan.request(12.0, NoPose(), ())
    plan.change(RegisterNext(15.0, forget_landmarks=True))
    moved = plan.request(15.0, NoPose(), ())
    assert first is not None
    assert again is not None
    assert moved is not None
    assert first.touched is again.touched is touched
    assert moved.touched is None
