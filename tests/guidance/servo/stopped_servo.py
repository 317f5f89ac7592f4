"""A program that runs one servo after another, to be stopped by signals from `test_stops.py`.

Each line of its input begins a servo, "watched" or not; it answers "ready" when a force is given. The next
line comes after the signals; it answers with what became of the servo, as JSON.
"""

import json
import sys
import threading
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


class Passing:
    """A thread that passes the servo's force on, as a live link does: when it asked, what it would send."""

    def __init__(self, servo):
        self.servo, self.rows, self.stop = servo, [], threading.Event()
        self.thread = threading.Thread(target=self.run)

    def run(self):
        while not self.stop.wait(0.002):
            asked_ns = time.monotonic_ns()
            sent = self.servo.newest()
            if sent is not None:
                reason = bool(sent.hazards & Hazard.MISSED_DEADLINES)
                size = float(np.abs(sent.force_n).sum())
                self.rows.append((asked_ns, size, sent.state is SupervisorState.LATCHED, reason))

    def __enter__(self):
        self.thread.start()

    def __exit__(self, *_):
        self.stop.set()
        self.thread.join()


def run_one(fixtures, transform, watched):
    """One servo until it has been stopped: the device's log, what was passed on, whether it tripped."""
    device = LoggingDevice()
    servo = Servo(fixtures, device, watchdog=watched)
    # many late ticks are the machine's; the gap that is looked for stays as it is
    servo._loop.numbers[kernel.LATE_NS] = NEVER_NS
    passing = Passing(servo)
    with servo:
        servo.publish(ServoInputs(transform, 0.0, Rigid.identity("tracker", "device"), valid_for_s=600.0))
        with passing:
            begin = time.monotonic()
            until(lambda: device.log[-1:, 2].any() or time.monotonic() > begin + 5.0)
            answer("ready")
            sys.stdin.readline()
            woken, passed = device.writes, len(passing.rows)
            until(lambda: device.writes > woken + 100 and len(passing.rows) > passed + 20)
        tripped = servo.watchdog_tripped
    return {"log": device.log.tolist(), "passed": passing.rows, "tripped": tripped}


def main():
    ball = ball_model()
    fixtures, transform = Fixtures(ball, FixtureSet()), steady_ball(ball)
    for line in sys.stdin:
        answer(json.dumps(run_one(fixtures, transform, line.strip() == "watched")))


if __name__ == "__main__":
    main()
