"""The servo in real time; nothing here depends on how quick the machine is."""

import time
from typing import Any

import numpy as np
import pytest
from numba import carray
from waiting import until

from dvf_ig.core import InvalidInputError, Rigid
from dvf_ig.guidance import Fixtures, FixtureSet, Hazard, RearmAnswer, SupervisorState
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.servo import Deadlines, Servo, ServoInputs, ServoOptions, SimulatedServo
from dvf_ig.guidance.servo.record import BINS, deadlines_of
from dvf_ig.kernels.servo.clock import monotonic_ns, sleep_until
from dvf_ig.kernels.servo.foreign import device_function

from .conftest import PATIENT_S

HERE = Rigid.identity("tracker", "device")
OK, DEGRADED, FADE, LATCHED = SupervisorState


@device_function
def slow_read(context, now_ns, out):
    """A device at 14 mm, whose reads now and then take so long: every c[3]-th c[4] ms."""
    c, position = carray(context, 8, np.int64), carray(out, 3)
    position[0], position[1], position[2] = 14.0, 0.0, 0.0
    c[0] += 1
    if c[0] % c[3] == 0:
        timespec = np.zeros(2, dtype=np.int64)
        sleep_until(monotonic_ns(timespec) + 1_000_000 * c[4], timespec)
    return 0


@device_function
def last_force(context, now_ns, force_n):
    """Keep the length of the last force, and count those that are zero."""
    c, force = carray(context, 8, np.int64), carray(force_n, 3)
    kept = carray(context, 8, np.float64)
    kept[1] = abs(force[0]) + abs(force[1]) + abs(force[2])
    c[2] += 1 if kept[1] == 0.0 else 0
    return 0


class SlowDevice:
    name, latency_s = "slow device", 0.0

    def __init__(self, every, milliseconds):
        self.context = np.zeros(8, dtype=np.int64)
        self.context[3:5] = every, milliseconds
        self.functions = np.array([slow_read.address, last_force.address])

    def close(self):
        pass


class Spoken:
    """A servo with a session that speaks whenever it is asked, at the machine's own time."""

    def __init__(self, servo, transform):
        self.servo, self.transform, self.begin = servo, transform, time.monotonic()

    def speak(self, **more):
        now = time.monotonic() - self.begin
        self.servo.publish(ServoInputs(self.transform, now, HERE, **({"valid_for_s": 5.0} | more)))

    def until(self, condition):
        """The first ticks that meet the condition; each is read once."""
        last: Any = None

        def fitting():
            nonlocal last
            last = self.servo.read()
            return last if len(last) and condition(last) else None

        return until(fitting, lambda: f"last {last.state[-1:]} {last.hazards[-1:]} {last.status[-1:]}")

    def until_state(self, state):
        return self.until(lambda record: state in record.state)


@pytest.fixture
def resting(ball, steady_ball):
    """A servo whose device rests 1.5 mm inside the ball's surface."""
    device = RecordedDevice(np.tile([14.0, 0.0, 0.0], (60_000, 1)), 1000.0)
    with Servo(Fixtures(ball, FixtureSet()), device, watchdog=False, late_s=PATIENT_S) as servo:
        yield Spoken(servo, steady_ball)


def test_the_force_begins_from_zero_with_the_first_word(resting):
    silent = resting.until(lambda record: True)
    assert not silent.sent_n.any()
    assert silent.hazards[0] == Hazard.NO_POSE
    resting.speak()
    record = resting.until_state(OK)
    assert np.linalg.norm(record.sent_n[-1]) > 0.1
    assert resting.servo.ticks > 10


def test_silence_releases_the_force_and_a_word_brings_it_back(resting):
    resting.speak()
    resting.until_state(OK)
    resting.speak(valid_for_s=0.0)
    record = resting.until_state(FADE)
    assert Hazard.SESSION_SILENT & record.hazards[-1]
    resting.until(lambda record: not record.sent_n[-1].any())
    resting.speak()
    resting.until_state(OK)


def test_rearming_is_answered_by_the_servo(resting):
    resting.speak(hazards=Hazard.NOT_FINITE)
    resting.until_state(LATCHED)
    assert resting.servo.rearm() is RearmAnswer.HAZARD_ACTIVE
    resting.speak()
    resting.until(lambda record: record.hazards[-1] == 0)
    assert resting.servo.rearm() is RearmAnswer.FORCE_WANTED
    assert resting.servo.rearm() is RearmAnswer.FORCE_WANTED
    resting.until_state(LATCHED)


def test_what_is_not_latched_is_not_rearmed(resting):
    resting.speak()
    resting.until_state(OK)
    assert resting.servo.rearm() is RearmAnswer.NOT_LATCHED


def test_no_force_is_left_when_it_stops(ball, steady_ball):
    device = SlowDevice(10_000_000, 0)
    with Servo(Fixtures(ball, FixtureSet()), device, watchdog=False, late_s=PATIENT_S) as servo:
        spoken = Spoken(servo, steady_ball)
        spoken.speak()
        spoken.until(lambda record: np.any(record.sent_n[-1]))
    assert device.context.view(np.float64)[1] == 0.0
    with pytest.raises(InvalidInputError, match="once"):
        servo.__enter__()


def test_the_watchdog_sends_no_force_where_a_tick_hangs(ball, steady_ball):
    device = SlowDevice(200, 60)
    with Servo(Fixtures(ball, FixtureSet()), device) as servo:
        spoken = Spoken(servo, steady_ball)
        spoken.speak()
        record = spoken.until_state(LATCHED)
        assert servo.watchdog_tripped
        assert record.hazards[-1] & Hazard.MISSED_DEADLINES
        sent_before = device.context[2]
        until(lambda: device.context[2] > sent_before)
        assert device.context.view(np.float64)[1] == 0.0
        assert servo.rearm() is RearmAnswer.HAZARD_ACTIVE
    assert servo.deadlines.skipped > 20


def test_three_late_ticks_of_a_hundred_latch(ball, steady_ball):
    """Every 30th read takes 5 ms: less than the watchdog waits for, three times in ninety ticks."""
    with Servo(Fixtures(ball, FixtureSet()), SlowDevice(30, 5), watchdog=False) as servo:
        spoken = Spoken(servo, steady_ball)
        spoken.speak()
        record = spoken.until_state(LATCHED)
        assert record.hazards[record.state == LATCHED][0] & Hazard.MISSED_DEADLINES
        assert not record.sent_n[record.state == LATCHED].any()


def test_the_rate_has_limits():
    for rate in (199.0, 4001.0):
        with pytest.raises(InvalidInputError, match="rate"):
            ServoOptions(rate_hz=rate)


def test_lateness_is_counted_in_whole_microseconds():
    found = deadlines_of(np.concatenate([np.full(98, 10.4), [55.0, 3e5]]), skipped=100)
    assert (found.ticks, found.run_share) == (100, 0.5)
    assert [found.percentile_us(p) for p in (50.0, 99.0, 100.0)] == [11.0, 56.0, 3e5]
    with pytest.raises(InvalidInputError, match="no tick"):
        Deadlines(np.zeros(BINS, dtype=np.int64), 0.0, 0).percentile_us(50.0)


@pytest.mark.parametrize(
    ("count", "by_s", "latches"), [(2, 0.0021, False), (3, 0.0019, False), (3, 0.0021, True)]
)
def test_late_ticks_latch_in_simulated_time_too(ball, steady_ball, count, by_s, latches):
    device = RecordedDevice(np.tile([10.0, -20.0, 30.0], (1000, 1)), 1000.0)
    servo = SimulatedServo(Fixtures(ball, FixtureSet()), device)
    late_s = np.zeros(300)
    late_s[100 : 100 + 45 * count : 45] = by_s
    inputs = ServoInputs(steady_ball, 0.0, Rigid.identity("tracker", "device"), valid_for_s=9.0)
    record = servo.run(inputs, 300, late_s)
    assert ((record.hazards & Hazard.MISSED_DEADLINES) != 0).any() == latches
    assert (record.state[-1] == LATCHED) == latches
    np.testing.assert_allclose(record.lateness_us[late_s > 0.0], 1e6 * by_s)
    skipped = round(1000.0 * record.t_s[-1]) + 1 - len(record)
    assert skipped == (count if by_s > 0.002 else 0), "a deadline more than a period before the tick's end"
    assert servo.now_s == pytest.approx(record.t_s[-1] + 0.001)


def test_a_latch_keeps_its_cause_until_it_is_rearmed(ball, steady_ball):
    """The hazard itself is active in one tick alone."""
    inside, outside = np.tile([14.0, 0.0, 0.0], (400, 1)), np.tile([18.0, 0.0, 0.0], (600, 1))
    device = RecordedDevice(np.concatenate([inside, outside]), 1000.0)
    servo = SimulatedServo(Fixtures(ball, FixtureSet()), device)
    inputs = ServoInputs(steady_ball, 0.0, Rigid.identity("tracker", "device"), valid_for_s=9.0)
    late_s = np.zeros(200)
    late_s[[100, 110, 120]] = 0.0021
    first = servo.run(inputs, 200, late_s)
    assert np.count_nonzero(first.hazards) == 1
    later = servo.run(inputs, 300).newest()
    assert later is not None
    assert later.state is LATCHED
    assert later.hazards is Hazard.MISSED_DEADLINES
    servo.ask_rearm()
    again = servo.run(inputs, 100).newest()
    assert servo.rearmed is RearmAnswer.ACCEPTED
    assert again is not None
    assert again.hazards is Hazard.NONE


@pytest.mark.parametrize(("by_s", "trips"), [(0.0085, False), (0.0095, True)])
def test_the_watchdog_trips_in_simulated_time_too(ball, steady_ball, by_s, trips):
    """No tick has ended for so long and a period."""
    device = RecordedDevice(np.tile([10.0, -20.0, 30.0], (1000, 1)), 1000.0)
    servo = SimulatedServo(Fixtures(ball, FixtureSet()), device)
    late_s = np.zeros(200)
    late_s[100] = by_s
    inputs = ServoInputs(steady_ball, 0.0, Rigid.identity("tracker", "device"), valid_for_s=9.0)
    servo.run(inputs, 200, late_s)
    assert servo.watchdog_tripped == trips
