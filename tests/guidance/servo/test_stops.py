"""A process that is stopped, and a loop that hangs, send no force first and stay latched with the reason.

Nothing here depends on how quick the machine is: gaps are those of the device's own log.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from logging_device import LoggingDevice
from waiting import until

import dvf_ig
from dvf_ig.core import Rigid
from dvf_ig.guidance import Fixtures, FixtureSet, Hazard, SupervisorState
from dvf_ig.guidance.servo import Servo, ServoInputs, SimulatedServo
from dvf_ig.kernels.servo import loop as kernel

STOPS_MS = (12, 12, 30, 30, 100, 500)
GAPS_MS = (12, 15, 30, 100, 500, 2000)
TRIES = 5
"""For a stop that finds no force: the machine itself had stopped the servo before."""
LIMIT_NS = 10_000_000
HERE = Rigid.identity("tracker", "device")
TESTS = Path(__file__).resolve().parents[2]


class StoppedServo:
    """The program of `stopped_servo.py`, whose servos are stopped one by one."""

    def __init__(self):
        paths = (TESTS / "toys", Path(dvf_ig.__file__).parents[1])
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("stopped_servo.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))},
        )
        self.asked: Any = self.process.stdin
        self.said: Any = self.process.stdout

    def stop(self, milliseconds, *, watched):
        """What a stop did: the device's (n, 3) log, rows that were passed on, whether the servo tripped."""
        self.say("watched" if watched else "alone")
        assert self.said.readline() == "ready\n"
        self.process.send_signal(signal.SIGSTOP)
        _, status = os.waitpid(self.process.pid, os.WUNTRACED)
        assert os.WIFSTOPPED(status)
        time.sleep(1e-3 * milliseconds)
        self.process.send_signal(signal.SIGCONT)
        self.say("woken")
        found = json.loads(self.said.readline())
        return np.array(found["log"]), found["passed"], found["tripped"]

    def say(self, line):
        self.asked.write(line + "\n")
        self.asked.flush()

    def end(self):
        self.process.communicate()
        assert self.process.returncode == 0


def last_before_gap(log):
    """Number of the last force before the first gap; None where there is no gap, or no force before it."""
    gaps = np.flatnonzero(np.diff(log[:, 0]) > LIMIT_NS + 1_000_000)
    return int(gaps[0]) if len(gaps) and log[gaps[0], 2] != 0 else None


def test_a_stopped_process_sends_no_force_first_and_latches_with_the_reason():
    servo, checked = StoppedServo(), 0
    for k, milliseconds in enumerate(STOPS_MS):
        for _ in range(TRIES):
            watched = k % 2 == 0
            log, passed, tripped = servo.stop(milliseconds, watched=watched)
            last = last_before_gap(log)
            if last is None:
                continue
            first = last + 1
            if log[first, 2] != 0:
                # on its way when the process was stopped: its tick had begun before
                assert log[first, 1] < log[last, 0] + LIMIT_NS, milliseconds
                first += 1
            assert not log[first:, 2].any(), (milliseconds, log[last : last + 5])
            after = [row[1:] for row in passed if row[0] > log[last, 0] + LIMIT_NS + 1_000_000]
            assert after == [[0.0, True, True]] * len(after), milliseconds
            assert len(after) >= 10
            assert tripped == watched
            checked += 1
            break
    servo.end()
    if checked == 0:
        pytest.skip("the machine stopped every servo before a signal did")


@pytest.mark.parametrize("milliseconds", GAPS_MS)
def test_a_gap_in_simulated_time_does_the_same(ball, steady_ball, milliseconds):
    device, late_s = LoggingDevice(), np.zeros(300)
    late_s[200] = 1e-3 * milliseconds
    servo = SimulatedServo(Fixtures(ball, FixtureSet()), device)
    record = servo.run(ServoInputs(steady_ball, 0.0, HERE, valid_for_s=9.0), 300, late_s)
    ticked = device.log[:, 1]
    last = int(np.flatnonzero(np.diff(ticked) > 9_000_000)[0])
    assert ticked[last + 1] == ticked[last] + LIMIT_NS, "when a watchdog sends it, before the late tick"
    assert device.log[last, 2] > 0
    assert not device.log[last + 1 :, 2].any()
    assert np.linalg.norm(record.sent_n[199]) > 0.1
    assert not record.sent_n[200:].any()
    assert (record.state[200:] == SupervisorState.LATCHED).all()
    assert (record.cause[200:] & Hazard.MISSED_DEADLINES).all()
    assert servo.watchdog_tripped


def test_a_gap_between_two_runs_is_one(ball, steady_ball):
    device, inputs = LoggingDevice(), ServoInputs(steady_ball, 0.0, HERE, valid_for_s=9.0)
    servo = SimulatedServo(Fixtures(ball, FixtureSet()), device)
    assert servo.run(inputs, 200).sent_n[-1].any()
    record = servo.run(inputs, 1, np.array([0.012]))
    assert not record.sent_n.any()
    assert servo.watchdog_tripped


@pytest.mark.parametrize("where", ["slow_read", "slow_write"])
@pytest.mark.parametrize("watched", [False, True])
def test_a_gap_within_a_tick_is_found_before_and_after_its_force_is_sent(ball, steady_ball, where, watched):
    """A read that hangs: its tick's force is not sent. A write that hangs: zero follows at once."""
    device = LoggingDevice(**{where: 300}, wait_s=0.06)
    servo = Servo(Fixtures(ball, FixtureSet()), device, watchdog=watched)
    servo._loop.numbers[kernel.LATE_NS] = 10**15
    with servo:
        servo.publish(ServoInputs(steady_ball, 0.0, HERE, valid_for_s=60.0))
        until(lambda: servo.ticks > 400)
        record = servo.read()
        sent = servo.newest()
    rows, log = np.flatnonzero(record.state == SupervisorState.LATCHED), device.log
    assert len(rows)
    assert not record.sent_n[rows].any()
    assert (record.cause[rows] & Hazard.MISSED_DEADLINES).all()
    last = int(np.flatnonzero(log[:, 2])[-1])
    assert not log[last + 1 :, 2].any()
    assert log[last + 1, 0] - log[last - 1, 0] > LIMIT_NS, "zero because of the gap"
    if not watched:
        assert record.hazards[rows[0]] & Hazard.MISSED_DEADLINES
    assert sent is None or (sent.state is SupervisorState.LATCHED and sent.hazards & Hazard.MISSED_DEADLINES)
