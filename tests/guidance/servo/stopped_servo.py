"""A program that runs one servo after another, to be stopped by signals from `test_stops.py`.

Each line of its input begins a servo, "watched" or not; it answers "ready" when a force is given. The next
line comes after the signals; it answers with what became of the servo, as JSON, and keeps the log in a file.
"""

import json
import sys
import time

import numpy as np
from logging_device import LoggingDevice
from toy_ball import ball_model
from waiting import until

from dvf_ig.core import PhaseForecast, PhaseState, PoseMotion, RetimingCurve, Rigid
from dvf_ig.guidance import Fixtures, FixtureSet, Hazard, PoseAndPhase, SupervisorState
from dvf_ig.guidance.servo import Servo, ServoInputs
from dvf_ig.kernels.servo import loop as kernel

NEVER_NS = 10**15


def steady_ball(ball):
    """The tracker is the model's frame, and the heart stands at one phase."""
    phase = PhaseForecast(
        since_s=-1.0,
        until_s=float("inf"),
        state=PhaseState.LOCKED,
        state_after=PhaseState.LOST,
        phi=0.05,
        r_s=-0.08,
        cycles=0.0,
        rr_s=1e6,
        spread=0.05,
        catch_up=3.0,
        r_timing_s=0.005,
    )
    pose = PoseMotion.still(Rigid.identity(ball.frame, "tracker"))
    return PoseAndPhase(pose, phase, RetimingCurve.uniform(), 0.04 * np.eye(6))


def answer(line):
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def run_one(fixtures, transform, watched):
    """One servo from its first force until it has been stopped; what it said, and the device's log."""
    device = LoggingDevice()
    servo = Servo(fixtures, device, watchdog=watched)
    # many late ticks are the machine's; the gap that is looked for stays as it is
    servo._loop.numbers[kernel.LATE_NS] = NEVER_NS
    with servo:
        servo.publish(ServoInputs(transform, 0.0, Rigid.identity("tracker", "device"), valid_for_s=600.0))
        begin = time.monotonic()
        until(lambda: device.log[-1:, 2].any() or time.monotonic() > begin + 5.0)
        answer("ready")
        sys.stdin.readline()
        woken, said = device.writes, []
        for count in (50, 100):
            until(lambda: device.writes > woken + count)  # noqa: B023  used at once
            said.append(servo.newest())
        return {
            "tripped": servo.watchdog_tripped,
            "latched": [one.state is SupervisorState.LATCHED for one in said],
            "reason": [bool(one.hazards & Hazard.MISSED_DEADLINES) for one in said],
        }, device.log


def main(log_path):
    ball = ball_model()
    fixtures, transform = Fixtures(ball, FixtureSet()), steady_ball(ball)
    for line in sys.stdin:
        found, log = run_one(fixtures, transform, line.strip() == "watched")
        np.save(log_path, log)
        answer(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1])
