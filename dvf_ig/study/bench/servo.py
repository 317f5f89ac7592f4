"""Lateness of the servo while Python burns the GIL, beside the machine's floor and a servo in Python."""

import gc
import json
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import DvfModel, Mesh, Rigid
from dvf_ig.guidance import (
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Gaussian,
    Hazard,
    PoseAndPhase,
    Sigmoid,
    Status,
)
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.servo import Deadlines, Servo, ServoInputs, ServoOptions, TrackedServo
from dvf_ig.guidance.servo.deadlines import BINS, deadlines_of
from dvf_ig.guidance.servo.threads import real_time_thread
from dvf_ig.kernels.servo import loop, shared

from .heart import hand_path
from .rows import steady
from .timing import Row

PUBLISH_S = 1.0 / 30.0
RATES_HZ = (1000.0, 4000.0)
TWO_FIXTURES = FixtureSet(
    (
        FixtureOptions(Sigmoid(depth_mm=1.0), name="wall"),
        FixtureOptions(Gaussian(6.0, 1.0, cap_n=0.4), name="surface"),
    )
)
"""A forbidden region and guidance to the surface: what the ticks evaluate."""


@dataclass(frozen=True, slots=True)
class ServoBench:
    """What `dvf-ig bench --servo` measured.

    Attributes:
        rows: lateness of each loop, µs.
        ticks, due: by row, ticks that ran and deadlines that there were.
        forced_ticks: by row, ticks of the servos that sent a force.
        realtime: the machine gave the loops a real-time priority.
        python_p99_ratio: p99 of the Python thread over that of the servo at 1 kHz.
    """

    rows: tuple[Row, ...]
    ticks: dict[str, int]
    due: dict[str, int]
    forced_ticks: dict[str, int]
    realtime: bool
    python_p99_ratio: float


def bench_servo(
    model: DvfModel, seconds: float, seed: int, progress: Callable[[float], None] | None = None
) -> ServoBench:
    """Each loop for so many seconds, one after the other, under the same load."""
    mesh = model.reference[model.ed_phase]
    fixtures = Fixtures(model, TWO_FIXTURES)
    rows: list[Row] = []
    ticks: dict[str, int] = {}
    due: dict[str, int] = {}
    forced: dict[str, int] = {}
    realtime = True

    def add(name: str, what: str, found: Deadlines, at: int) -> None:
        rows.append(_row(name, what, found))
        ticks[what], due[what] = found.ticks, found.ticks + found.skipped
        if progress is not None:
            progress(at / 5.0)

    add("machine", "servo floor", _floor(seconds, 1000.0), 1)
    for k, rate_hz in enumerate(RATES_HZ):
        what = f"servo {rate_hz / 1e3:.0f} kHz"
        found, pushed, granted = _servo(fixtures, mesh, seconds, rate_hz, seed)
        add("dvf_ig", what, found, k + 2)
        forced[what], realtime = pushed, realtime and granted
    add("machine", "servo floor, 4 kHz", _floor(seconds, 4000.0), 4)
    add("python", "servo python thread", _python_thread(fixtures, mesh, seconds, seed), 5)
    p99 = {row.what: row.p99_us for row in rows}
    return ServoBench(
        tuple(rows), ticks, due, forced, realtime, p99["servo python thread"] / p99["servo 1 kHz"]
    )


def burn(seconds: float, often: Callable[[], None], every_s: float = PUBLISH_S) -> None:
    """Pure Python, JSON and garbage collection until the time is over, and `often` now and then.

    All of it holds the GIL; the collector runs over many objects that refer to one another.
    """
    end = time.monotonic() + seconds
    due = 0.0
    kept: list[dict[str, object]] = []
    while (now := time.monotonic()) < end:
        if now >= due:
            often()
            due = now + every_s
        made: dict[str, object] = {str(k): [k, {"squared": k * k}] for k in range(300)}
        made["itself"] = made
        kept.append(made)
        json.loads(json.dumps({str(k): list(range(10)) for k in range(50)}))
        if len(kept) > 30:
            kept.clear()
            gc.collect()


def _servo(
    fixtures: Fixtures, mesh: Mesh, seconds: float, rate_hz: float, seed: int
) -> tuple[Deadlines, int, bool]:
    """Deadlines, ticks that sent a force, whether the loop had real-time priority."""
    device = _moving_hand(mesh, seconds, seed)
    begin = time.monotonic()
    transform = _steady_transform(fixtures.model)
    forced = 0
    with Servo(fixtures, device, options=ServoOptions(rate_hz=rate_hz)) as servo:

        def speak() -> None:
            nonlocal forced
            servo.publish(
                ServoInputs(transform, time.monotonic() - begin, Rigid.identity("tracker", "device"))
            )
            forced += int((np.abs(servo.read().sent_n).max(axis=1, initial=0.0) > 0.0).sum())

        burn(seconds, speak)
    return servo.deadlines, forced, servo.realtime


def _floor(seconds: float, rate_hz: float) -> Deadlines:
    numbers, histogram = np.zeros(loop.NUMBERS, dtype=np.int64), np.zeros(BINS, dtype=np.int64)
    stopped = numbers.copy()
    stopped[loop.STOP] = 1
    period_ns = round(1e9 / rate_hz)
    loop.measure_floor(stopped, histogram, period_ns)
    thread, _ = real_time_thread("dvf-ig floor", loop.measure_floor, numbers, histogram, period_ns)
    burn(seconds, lambda: None)
    shared.store_number(numbers, loop.STOP, 1)
    thread.join()
    return Deadlines(histogram, float(numbers[loop.WORST_NS]) / 1e3, int(numbers[loop.SKIPPED]))


def _python_thread(fixtures: Fixtures, mesh: Mesh, seconds: float, seed: int) -> Deadlines:
    """The same ticks stepped by a Python thread of the same priority."""
    path = hand_path(mesh, round(seconds * 1000.0) + 1000, np.random.default_rng(seed))
    late: list[float] = []
    skipped = 0
    stop = threading.Event()
    servo, transform = TrackedServo(fixtures), _steady_transform(fixtures.model)
    still, nothing = np.zeros(3), np.zeros(0)

    def ticks() -> None:
        nonlocal skipped
        begin = time.monotonic()
        due = 0
        while not stop.is_set():
            due += 1
            now = time.monotonic() - begin
            if now < due * 1e-3:
                time.sleep(due * 1e-3 - now)
                now = time.monotonic() - begin
            late.append(1e6 * (now - due * 1e-3))
            servo.step(now, transform, Hazard.NONE, Status.OK, nothing, (path[due % len(path)], still))
            passed = int((time.monotonic() - begin) / 1e-3) - due
            if passed > 0:
                skipped += passed
                due += passed

    thread, _ = real_time_thread("python servo", ticks)
    burn(seconds, lambda: None)
    stop.set()
    thread.join()
    return deadlines_of(np.array(late), skipped)


def _moving_hand(mesh: Mesh, seconds: float, seed: int) -> RecordedDevice:
    """A hand's path about the heart; longer than the run, whose servo starts a little earlier."""
    path = hand_path(mesh, round((seconds + 5.0) * 1000.0), np.random.default_rng(seed))
    return RecordedDevice(path, 1000.0)


def _steady_transform(model: DvfModel) -> PoseAndPhase:
    return PoseAndPhase(*steady(Rigid.identity(model.frame, "tracker")))


def _row(name: str, what: str, found: Deadlines) -> Row:
    median, p99, p999 = (found.percentile_us(p) for p in (50.0, 99.0, 99.9))
    note = f"{found.ticks} of {found.ticks + found.skipped} ticks"
    return Row(name, what, median, p99, p999, found.worst_us, None, 1, note)
