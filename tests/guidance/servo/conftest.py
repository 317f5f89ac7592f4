"""A ball that beats and drifts, seen through a pose that moves: everything a tick can depend on."""

import math

import numpy as np
import pytest

from dvf_ig.core import PhaseForecast, PhaseState, PoseMotion, RetimingCurve, Rigid
from dvf_ig.guidance import Confinement, FixtureOptions, Fixtures, FixtureSet, Gaussian, PoseAndPhase, Sigmoid

RATE_HZ = 1000.0
PATIENT_S = 10.0
"""A machine busy with other programs makes late ticks: what is no test of lateness allows them."""
TRACKER_FROM_DEVICE = Rigid.from_rotation_vector([0.3, -0.2, 0.5], [40.0, -10.0, 5.0], "tracker", "device")
THREE = FixtureSet(
    (
        FixtureOptions(Sigmoid(1.2, 0.5), name="wall"),
        FixtureOptions(Confinement(0.8, 0.3, -6.0), "distance", name="room"),
        FixtureOptions(Gaussian(6.0, 1.0, 0.4, depth_mm=-1.0), "periodic", name="surface"),
    ),
    cap_n=0.6,
)


def beat(**changed):
    values = {
        "since_s": 0.0,
        "until_s": math.inf,
        "state": PhaseState.LOCKED,
        "state_after": PhaseState.LOST,
        "phi": 0.1,
        "r_s": -0.08,
        "cycles": 0.0,
        "rr_s": 0.8,
        "spread": 0.05,
        "catch_up": 3.0,
        "r_timing_s": 0.005,
    }
    return PhaseForecast(**(values | changed))


@pytest.fixture(scope="session")
def moving(ball):
    """A pose that moves during the first second, and a heart that beats."""
    start = Rigid.from_rotation_vector([0.1, 0.4, -0.2], [-20.0, 5.0, 8.0], ball.frame, "tracker")
    end = Rigid.from_rotation_vector([0.13, 0.38, -0.2], [-18.0, 6.0, 7.0], ball.frame, "tracker")
    motion = PoseMotion.towards(start, end, 0.1, np.zeros(3))
    return PoseAndPhase(motion, beat(), RetimingCurve.uniform(), 0.04 * np.eye(6))


@pytest.fixture(scope="session")
def three(ball):
    return Fixtures(ball, THREE)


@pytest.fixture(scope="session")
def path_mm(moving):
    """(1500, 3) positions of a device, frame "device": in and out of the ball's surface."""
    t = np.arange(1500) / RATE_HZ
    reach = 15.0 + 2.5 * np.sin(2.0 * np.pi * 1.3 * t)
    turn = 0.5 * t
    in_model = np.stack(
        [reach * np.cos(turn), reach * np.sin(turn) * 0.8, reach * np.sin(turn) * 0.6], axis=1
    )
    to_tracker = moving.pose.end.inverse()
    return TRACKER_FROM_DEVICE.inverse().apply_array(to_tracker.apply_array(in_model))


@pytest.fixture(scope="session")
def steady_ball(ball):
    """The tracker is the model's frame, and the heart stands at one phase."""
    pose = PoseMotion.still(Rigid.identity(ball.frame, "tracker"))
    return PoseAndPhase(pose, beat(since_s=-1.0, phi=0.05, rr_s=1e6), RetimingCurve.uniform())
