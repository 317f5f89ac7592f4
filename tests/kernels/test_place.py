"""The pose, model phase and rates of the servo kernel against the values they are packed from."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dvf_ig.core import PhaseForecast, PhaseState, PoseMotion, RetimingCurve, Rigid
from dvf_ig.kernels import place as kernels
from dvf_ig.kernels import status as code

small = st.floats(-2.0, 2.0)
CENTER_MM = np.array([20.0, -30.0, 100.0])
START = Rigid.from_rotation_vector([0.5, 0.2, -0.4], [300.0, -200.0, 500.0], "mr", "tracker")


@settings(max_examples=60)
@given(
    turn=st.tuples(small, small, small),
    shift=st.tuples(small, small, small),
    phi=st.floats(0.0, 0.999),
    cycles=st.integers(-1, 2),
    knots=st.tuples(st.floats(0.2, 0.7), st.floats(0.2, 0.7), st.floats(0.5, 1.2), st.floats(0.5, 1.2)),
)
def test_place_is_its_readable_twin(turn, shift, phi, cycles, knots):
    target = START.perturbed_left(np.array(turn), np.array(shift), CENTER_MM)
    motion = PoseMotion.towards(START, target, 10.0, CENTER_MM, speed_mm_s=50.0)
    phase = PhaseForecast(
        9.9, 12.0, PhaseState.LOCKED, PhaseState.LOST, phi, 9.8, float(cycles), 0.7, 0.06, 3.0, 0.005
    )
    curve = RetimingCurve(*knots)
    packed = kernels.packed_pose_and_phase(motion, math.inf, phase, curve, None, np.zeros(3))
    place = np.zeros(1, kernels.PLACE)
    t = np.concatenate([np.linspace(9.9, 12.0, 23), [10.0, motion.end_s]])
    readings, poses = phase.at_many(t), motion.matrices(t)
    for k, t_s in enumerate(t.tolist()):
        inside = 9.9 <= t_s <= 12.0
        assert kernels.place_tick(packed[0], t_s, place[0]) == (code.OK if inside else code.NO_PHASE)
        np.testing.assert_allclose(place["model_from_tracker"][0], poses[k], atol=1e-12, rtol=1e-12)
        velocity = np.cross(place["turn_rate"][0], CENTER_MM + 30.0) + place["origin_velocity"][0]
        expected = motion.velocity_mm_s((CENTER_MM + 30.0)[None], t[k : k + 1])[0]
        np.testing.assert_allclose(velocity, expected, atol=1e-9)
        if inside:
            slope = float(curve.slope(readings.phi[k]))
            rate, sigma = slope * readings.rate_hz[k], slope * readings.sigma_phi[k]
            found = [place[f"model_phase{what}"][0] for what in ("", "_rate", "_sigma")]
            expected = [curve.at(readings.phi[k]), rate, sigma]
            np.testing.assert_allclose(found, expected, atol=1e-12, rtol=1e-12)


def test_what_is_not_known_is_not_a_number():
    phase = PhaseForecast(9.9, 12.0, PhaseState.LOCKED, PhaseState.LOST, 0.1, 9.8, 0.0, 0.7, 0.06, 3.0, 0.005)
    curve, place = RetimingCurve.uniform(), np.zeros(1, kernels.PLACE)

    def status_and_known(pose, until_s, t_s):
        packed = kernels.packed_pose_and_phase(pose, until_s, phase, curve, None, np.zeros(3))
        found, numbers = kernels.place_tick(packed[0], t_s, place[0]), place.view(np.float64)
        return found, bool(np.isfinite(numbers[:18]).all()), bool(np.isfinite(numbers[18:]).all())

    still = PoseMotion.still(START)
    assert status_and_known(still, math.inf, 10.0) == (code.OK, True, True)
    assert status_and_known(still, 10.0, 10.0) == (code.NO_POSE, False, True)
    assert status_and_known(None, math.inf, 10.0) == (code.NO_POSE, False, True)
    assert status_and_known(still, math.inf, 12.01) == (code.NO_PHASE, True, False)
    assert status_and_known(still, math.inf, 9.8) == (code.NO_PHASE, True, False)
    for t_s in (math.nan, math.inf, -math.inf):
        assert status_and_known(still, math.inf, t_s) == (code.FAULT, False, False)
