"""A haptic device as the tool of a session that stands still: the ball 15 mm about the tracker's origin."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from toy_ball import ball_model

from dvf_ig.core import PhaseForecast, PhaseState, Points, PoseMotion, RetimingCurve, Rigid
from dvf_ig.guidance import DeviceLimits, Fixtures, FixtureSet, Hazard, PoseAndPhase, SupervisorState
from dvf_ig.guidance.devices import HeldDevice
from dvf_ig.guidance.servo import SentForce, ServoInputs
from dvf_ig.live.frames import LiveEvent
from dvf_ig.live.haptic import HapticTool
from dvf_ig.session import ToolPose

NEVER_NS = 10**15
TIP = Points("tool", np.array([[0.0, 0.0, 150.0]]))
PLACE = Rigid.from_rotation_vector([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], "tracker", "device")


@cache
def steady_transform() -> PoseAndPhase:
    beat = PhaseForecast(
        since_s=-1.0, until_s=math.inf, state=PhaseState.LOCKED, state_after=PhaseState.LOST, phi=0.05,
        r_s=-0.08, cycles=0.0, rr_s=1e6, spread=0.05, catch_up=3.0, r_timing_s=0.005,
    )  # fmt: skip
    return PoseAndPhase(PoseMotion.still(Rigid.identity("mr", "tracker")), beat, RetimingCurve.uniform())


class SteadyState:
    """What `HapticTool` takes of a `GuidanceState`."""

    def __init__(self, now_s: float) -> None:
        self.now_s = now_s

    def inputs(self, place: Rigid) -> ServoInputs:
        return ServoInputs(steady_transform(), self.now_s, place, valid_for_s=30.0)


def steady_state(now_s: float) -> Any:
    return SteadyState(now_s)


def toy_tool(device: HeldDevice, tell: Callable[[str], None]) -> HapticTool:
    """The device at the ball, with the limits of a device that is not named."""
    return HapticTool(device, Fixtures(ball_model(), FixtureSet()), DeviceLimits(), PLACE, TIP, tell)


class FollowingTool:
    """A `HapticTool` without a servo: its tip is the tool that peers send, its force constant and latched."""

    def __init__(self) -> None:
        self.waiting: list[ToolPose] = []
        self.published = self.rearms = 0
        self.ended = ""
        force_n = np.array([0.1, 0.2, 0.3])
        self.sent = SentForce(0.0, force_n, SupervisorState.LATCHED, Hazard.DEVICE_LOST)

    def follow(self, pose: ToolPose) -> None:
        self.waiting.append(pose)

    def poses(self, now_s: float) -> list[LiveEvent]:
        newest, self.waiting = self.waiting[-1:], []
        return [LiveEvent(now_s, ToolPose(one.t_s, one.tracker_from_tool, True)) for one in newest]

    def publish(self, state: Any) -> None:
        self.published += 1

    def rearm_pressed(self) -> bool:
        return False

    def rearm(self) -> None:
        self.rearms += 1

    def withdraw(self, reason: str) -> None:
        self.ended = reason
