"""A haptic device as the tool of a live session: its tip goes to the session, its servo gives the force.

    device ─► tip, frame "tracker" ─► ToolPose ─► Session ─► ServoInputs ─► Servo ─► device      1 to 4 kHz
    button, or the operator's key ─► re-arm, judged by the servo's last tick

Every method but `withdraw` is called by the session's thread. The servo does not wait for it: silence of the
session withdraws the force as every other hazard does.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Points, Rigid
from dvf_ig.core.space.frames import require_same_frame
from dvf_ig.guidance import DeviceLimits, Fixtures, Hazard, RearmAnswer, SupervisorState
from dvf_ig.guidance.devices import HeldDevice, SimulatedStylus, position_mm
from dvf_ig.guidance.devices.simulated import Hand
from dvf_ig.guidance.servo import (
    Deadlines,
    SentForce,
    Servo,
    ServoInputs,
    ServoOptions,
    ServoRecord,
)
from dvf_ig.guidance.servo.record import deadlines_together
from dvf_ig.guidance.servo.servo import LATE_NS
from dvf_ig.session import GuidanceState, ToolPose

from .frames import LiveEvent

POSES_S = 0.009
"""Poses of the tip reach the session this far apart or further: about as often as it gives a state."""
HAND_STIFFNESS_N_PER_M, HAND_DAMPING_N_S_PER_M = 100.0, 4.0
"""Hand on a simulated device: it follows the tool's poses that peers send. By judgement: a hand that lets go
of 0.6 N moves 6 mm (docs/theory/safety.md)."""
ANSWERS_WITHIN_S, TICKS_BEFORE_REARM = 0.1, 3
NOT_FOLLOWED = "poses of the tool come by network, but the haptic device is the tool; they are not used"


@dataclass(slots=True)
class HapticCounts:
    """Counts over the ticks of a device's servo."""

    ticks: int = 0
    forced_ticks: int = 0
    largest_n: float = 0.0
    deepest_mm: float = -np.inf
    by_state: dict[str, int] = field(default_factory=lambda: dict.fromkeys(SupervisorState.__members__, 0))
    latches: list[str] = field(default_factory=list)

    def add(self, record: ServoRecord) -> None:
        """Count the ticks of a record."""
        size_n = np.linalg.norm(record.sent_n, axis=1)
        self.ticks += len(record)
        self.forced_ticks += int((size_n > 0.0).sum())
        self.largest_n = max(self.largest_n, float(size_n.max(initial=0.0)))
        # the distance to a path has no sign, and no rate
        finite = record.distance_mm[np.isfinite(record.distance_mm + record.rows["rate_mm_per_cycle"])]
        self.deepest_mm = max(self.deepest_mm, float(finite.max(initial=-np.inf)))
        for state in SupervisorState:
            self.by_state[state.name] += int((record.state == state).sum())


class HapticTool:
    """Context manager that drives a device from a session's states.

    Args:
        device: open; closed with the context.
        fixtures: on the patient's model, within `limits`.
        limits: of the device (`limits_of`).
        tracker_from_device: place of the device.
        tip: tool tip of the session, one point in frame "tool"; the device's tip takes its place, or with a
            fulcrum the tip of the instrument that the device holds.
        tell: called with a sentence whenever the force is withdrawn or given again.
        late_s: as of `Servo`.
    Raises:
        InvalidInputError: as `Servo`, frames that do not fit, or a shaft whose direction is not known.
    """

    def __init__(
        self,
        device: HeldDevice,
        fixtures: Fixtures,
        limits: DeviceLimits,
        tracker_from_device: Rigid,
        tip: Points,
        tell: Callable[[str], None],
        late_s: float = LATE_NS * 1e-9,
    ) -> None:
        require_same_frame("tracker", tracker_from_device.target, "place of the haptic device")
        require_same_frame("device", tracker_from_device.source, "place of the haptic device")
        self.device, self.counts = device, HapticCounts()
        self._place, self._tip_mm, self._tell = tracker_from_device, tip.xyz_mm[0], tell
        tool = fixtures.options.tool
        tool.require_device(device.name)
        self._fulcrum = tool.fulcrum
        options = ServoOptions(rate_hz=device.rate_hz)
        self._servo = Servo(fixtures, device, limits=limits, options=options, late_s=late_s)
        self._deadlines: list[Deadlines] = []
        self._inputs: ServoInputs | None = None
        self._published_s = self._posed_s = -np.inf
        self._followed = not isinstance(device, SimulatedStylus)
        self._pressed, self._said, self._ended = False, False, ""
        self._sent = SentForce(0.0, np.zeros(3), SupervisorState.DEGRADED, Hazard.NONE)

    def __enter__(self) -> "HapticTool":
        self._first_mm = position_mm(self.device)
        try:
            self._start_servo(self._servo)
        except BaseException:
            self._servo.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.withdraw("the session has ended")
        self._servo.__exit__(kind, error, trace)
        self.counts.add(self._servo.read())
        self.device.close()

    # ------------------------------------------------------------------ the tip

    def follow(self, pose: ToolPose) -> None:
        """Let the hand on a simulated device follow a pose of the tool; said once of another device."""
        device, matrix = self.device, pose.tracker_from_tool
        if not isinstance(device, SimulatedStylus):
            if not self._said:
                self._said = True
                self._tell(NOT_FOLLOWED)
            return
        if matrix is None or not np.isfinite(matrix).all():
            return
        in_tracker_mm = matrix[:3, :3] @ self._tip_mm + matrix[:3, 3]
        if self._fulcrum is not None:
            in_tracker_mm = self._fulcrum.other_end_mm(in_tracker_mm)
        hand_mm = np.asarray(self._place.inverse().apply_array(in_tracker_mm))
        device.hold(Hand(np.zeros(3), hand_mm, HAND_STIFFNESS_N_PER_M, HAND_DAMPING_N_S_PER_M))
        if not self._followed:
            self._followed, self._first_mm = True, hand_mm
            device.place(hand_mm)

    def poses(self, now_s: float) -> list[LiveEvent]:
        """Return the tip's newest pose if the last is POSES_S old; none before a simulated hand moves."""
        if now_s - self._posed_s < POSES_S or not self._followed:
            return []
        self._posed_s = now_s
        record = self._read()
        fresh = record.t_s >= self._published_s
        if not np.isfinite(self._published_s):
            first_mm = np.asarray(self._place.apply_array(self._first_mm))
            return [
                self._pose(now_s, first_mm if self._fulcrum is None else self._fulcrum.other_end_mm(first_mm))
            ]
        if not fresh.any():
            return []
        lost = bool(record.hazards[-1] & Hazard.DEVICE_LOST)
        return [self._pose(float(record.t_s[-1]), None if lost else record.xyz_mm[-1])]

    def _pose(self, t_s: float, tip_mm: FloatArray | None) -> LiveEvent:
        matrix = None
        if tip_mm is not None:
            matrix = np.eye(4)
            matrix[:3, 3] = tip_mm - self._tip_mm
        return LiveEvent(t_s, ToolPose(t_s, matrix, by_encoders=True))

    # ------------------------------------------------------------------ the force

    def publish(self, state: GuidanceState) -> None:
        """Hand the servo what the session knows; its times are those of the monotonic clock."""
        self.publish_inputs(state.inputs(self._place), state.now_s)

    def publish_inputs(self, inputs: ServoInputs, now_s: float) -> None:
        """Hand the servo its inputs, of `now_s` by the monotonic clock."""
        self._inputs = inputs
        self._servo.publish(inputs, now_s)
        if not np.isfinite(self._published_s):
            self._published_s = time.monotonic()

    @property
    def ended(self) -> str:
        """Why the force ended for good; empty while it has not."""
        return self._ended

    @property
    def sent(self) -> SentForce:
        """The force sent last, its servo's state, and the reasons."""
        return self._sent

    def rearm_pressed(self) -> bool:
        """Check whether the button was pressed since the last call, while latched."""
        before, self._pressed = self._pressed, self.device.pressed
        return self._pressed and not before and self._sent.state is SupervisorState.LATCHED

    def rearm(self) -> RearmAnswer:
        """An operator's request, judged by the servo; said, whatever the answer."""
        if self._servo.watchdog_tripped and not self._ended:
            self._replace_servo()
        answer = self._servo.rearm()
        if answer is not RearmAnswer.NOT_LATCHED:
            self._tell(f"re-arm of {self.device.name}: {answer.value}")
        return answer

    def _replace_servo(self) -> None:
        """Put a latched successor in the place of a servo whose watchdog has tripped."""
        old, new = self._servo, self._servo.successor()
        old.__exit__(None, None, None)
        self.counts.add(old.read())
        self._deadlines.append(old.deadlines)
        if self._inputs is not None:
            new.publish(self._inputs, self._inputs.now_s)
        self._servo = new
        self._start_servo(new)
        if self._ended:  # a signal came meanwhile
            new.withdraw()

    def _start_servo(self, servo: Servo) -> None:
        """Start it, and enable the device's force once commands keep its watchdog from expiring."""
        servo.__enter__()
        until_s = time.monotonic() + ANSWERS_WITHIN_S
        while servo.ticks < TICKS_BEFORE_REARM and time.monotonic() < until_s:
            time.sleep(0.001)
        self.device.enable_force()

    def withdraw(self, reason: str) -> None:
        """End the force within a tick, for good; from any thread and from a signal's handler."""
        self._ended = self._ended or reason
        self._servo.withdraw()
        self._sent = SentForce(self._sent.t_s, np.zeros(3), SupervisorState.LATCHED, self._sent.hazards)

    def _read(self) -> ServoRecord:
        """Read the ticks since the last call, count them, and say what changed."""
        record = self._servo.read()
        self.counts.add(record)
        sent = record.newest() or self._sent
        if self._servo.silent:
            hazards = sent.hazards | Hazard.MISSED_DEADLINES
            sent = SentForce(sent.t_s, np.zeros(3), SupervisorState.LATCHED, hazards)
        before, self._sent = self._sent, self._sent if self._ended else sent
        if self._sent.state is before.state:
            return record
        if self._sent.state is SupervisorState.LATCHED:
            cause = Hazard(int(record.cause[-1])) if len(record) else Hazard.NONE
            why = "; ".join((cause or self._sent.hazards).sentences)
            self.counts.latches.append(why)
            self._tell(f"{self.device.name} latched without force: {why}; press its button, or r and Enter")
        elif before.state is SupervisorState.LATCHED:
            self._tell(f"{self.device.name} is re-armed; the force rises within 0.5 s")
        return record

    def result(self) -> dict[str, Any]:
        """JSON values of the run, once it has ended."""
        deadlines = deadlines_together([*self._deadlines, self._servo.deadlines])
        counts = self.counts
        ticks = deadlines.ticks > 0
        return {
            "name": self.device.name,
            "rate_hz": self.device.rate_hz,
            "realtime": self._servo.realtime,
            "ticks": deadlines.ticks,
            "skipped": deadlines.skipped,
            "run_share": deadlines.run_share,
            "lateness_us": {
                "median": deadlines.percentile_us(50.0) if ticks else None,
                "p99": deadlines.percentile_us(99.0) if ticks else None,
                "p999": deadlines.percentile_us(99.9) if ticks else None,
                "max": deadlines.worst_us,
            },
            "ticks_with_force": counts.forced_ticks,
            "largest_force_n": counts.largest_n,
            "deepest_mm": counts.deepest_mm if np.isfinite(counts.deepest_mm) else None,
            "servo_states": dict(counts.by_state),
            "latches": list(counts.latches),
            "ended": self._ended,
        }


def place_of(device: HeldDevice, tracker_from_device: Rigid | None) -> Rigid:
    """Return the place of a device; a simulated one without a place moves in the tracker's own axes.

    Raises:
        InvalidInputError: another device without a place.
    """
    if tracker_from_device is not None:
        return tracker_from_device
    if isinstance(device, SimulatedStylus):
        return Rigid.from_matrix(np.eye(4), "tracker", "device")
    raise InvalidInputError(
        f"the session does not state the place of {device.name}; touch three or more points with it "
        "(dvf-ig calibrate device POINTS -o device.json) and name the file",
        key="calibration.device",
    )
