"""One fault at the servo, in simulated time: positions of the hand, silent devices and sessions, late ticks.

The device is moved along given positions, fails when it should, and records what it is sent.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numba import carray

from data_synth.seeds import child_rng
from dvf_ig.core import BoolArray, FloatArray, Rigid
from dvf_ig.guidance import Fixtures, Hazard, SupervisorState
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, ServoRecord, SimulatedServo
from dvf_ig.kernels.servo.foreign import device_function
from dvf_ig.study.faults.session_trial import OUT_MM, FaultRun, TrialTrace
from dvf_ig.study.passivity import steady_transform, wall_model

COUNT, START_NS, WRITTEN, HEADER = 0, 1, 2, 8
"""Offsets in its context, float64 in an int64 array; then 4 numbers a sample and 4 a write."""
RATE_HZ = 1000.0
WRITES_A_SAMPLE = 2
"""Room for those of the loop and of the watchdog."""


@device_function
def _read(context: Any, now_ns: int, out: Any) -> int:
    """The sample of that time since the first read; not 0 where the device does not answer."""
    header = carray(context, HEADER, np.float64)
    position = carray(out, 3)
    if header[START_NS] == 0.0:
        header[START_NS] = float(now_ns)
    count = int(header[COUNT])
    at = min(int((now_ns - header[START_NS]) * 1e-9 * RATE_HZ + 1e-6), count - 1)
    samples = carray(context, HEADER + 4 * count, np.float64)
    for k in range(3):
        position[k] = samples[HEADER + 4 * at + k]
    return int(samples[HEADER + 4 * at + 3])


@device_function
def _write(context: Any, now_ns: int, force_n: Any) -> int:
    """Note when a force was sent, and the force."""
    header = carray(context, HEADER, np.float64)
    force = carray(force_n, 3)
    count, written = int(header[COUNT]), int(header[WRITTEN])
    if written >= WRITES_A_SAMPLE * count:
        return 0
    log = carray(context, HEADER + 4 * count + 4 * WRITES_A_SAMPLE * count, np.float64)
    at = HEADER + 4 * count + 4 * written
    log[at] = (now_ns - header[START_NS]) * 1e-9
    for k in range(3):
        log[at + 1 + k] = force[k]
    header[WRITTEN] = float(written + 1)
    return 0


class FaultyDevice:
    """A `HapticDevice` of RATE_HZ samples.

    Args:
        position_mm: (n, 3) frame "device".
        silent: (n,) True where it does not answer.
    """

    name, latency_s = "faulty device", 0.0

    def __init__(self, position_mm: FloatArray, silent: BoolArray) -> None:
        n = len(position_mm)
        self.functions = np.array([_read.address, _write.address])
        self.context = np.zeros(HEADER + 4 * n * (1 + WRITES_A_SAMPLE), dtype=np.int64)
        numbers = self.context.view(np.float64)
        numbers[COUNT] = n
        samples = numbers[HEADER : HEADER + 4 * n].reshape(n, 4)
        samples[:, :3], samples[:, 3] = position_mm, silent

    @property
    def sent(self) -> FloatArray:
        """(m, 4) time since the first read, s, and force sent, N, in order of time."""
        numbers = self.context.view(np.float64)
        begin = HEADER + 4 * int(numbers[COUNT])
        return numbers[begin : begin + 4 * int(numbers[WRITTEN])].reshape(-1, 4).copy()

    def close(self) -> None:
        """Do nothing: nothing is open."""


BEGIN_S = 1.0
"""The force has risen by then; the fault begins within 0.1 s from here on."""
REACH_MM = 2.0
"""How deep in the wall the hand is."""
OUT_AFTER_S, REARM_AFTER_S, UNTIL_S = 1.5, 1.5, 1.5
"""After a fault the hand waits, leaves the wall to re-arm, and comes back; each so long after the other."""
PUBLISH_S = 1.0 / 30.0


@dataclass(slots=True)
class Servoing:
    """Inputs of a servo, tick by tick; faults change them.

    Attributes:
        place_mm: (n, 3) of the hand.
        silent: (n,) the device does not answer.
        late_s: (n,) by which each tick wakes late.
        publishing: (n,) the session speaks.
        options: of the servo.
        onset: tick with which the fault begins, if not the given one.
    """

    place_mm: FloatArray
    silent: BoolArray
    late_s: FloatArray
    publishing: BoolArray
    options: ServoOptions = field(default_factory=ServoOptions)
    onset: int | None = None


Change = Callable[[Servoing, int, int, np.random.Generator], None]
"""Puts a fault into the ticks from the first to before the second."""


@dataclass(frozen=True, slots=True)
class ServoFault:
    """One fault at the servo.

    Attributes:
        change: what it does.
        seconds: how long.
        by_energy: it begins when the energy made passes the limit, as summed from the record.
        restarts: only a new servo gives force again.
    """

    change: Change
    seconds: float
    by_energy: bool = False
    restarts: bool = False


def run_servo_fault(fault: ServoFault, seed: int) -> FaultRun:
    """Put a fault into a servo's ticks and run them."""
    rng = child_rng(seed, "servo")
    first = round(RATE_HZ * (BEGIN_S + 0.1 * float(rng.uniform())))
    last = first + max(1, round(RATE_HZ * fault.seconds))
    rearm = last + round(RATE_HZ * (OUT_AFTER_S + REARM_AFTER_S))
    ticks = rearm + round(RATE_HZ * UNTIL_S)
    servoing = Servoing(
        _places(ticks, last, rearm, rng),
        np.zeros(ticks, dtype=np.bool_),
        np.zeros(ticks),
        np.ones(ticks, dtype=np.bool_),
    )
    fault.change(servoing, first, last, rng)
    device = FaultyDevice(servoing.place_mm, servoing.silent)
    record = _run(servoing, device, rearm)
    onset = first if servoing.onset is None else servoing.onset
    begin_s = float(record.t_s[onset] - servoing.late_s[onset])
    if fault.by_energy:
        begin_s = _energy_passes(record, servoing.options)
    end_s, rearm_s = (float(record.t_s[min(k, len(record) - 1)]) for k in (last, rearm))
    return FaultRun(_course(record, device), begin_s, end_s, rearm_s)


def _places(ticks: int, last: int, rearm: int, rng: np.random.Generator) -> FloatArray:
    """A hand that rests in the wall, trembles a little, and leaves it around the re-arm."""
    t_s = np.arange(ticks) / RATE_HZ
    turns = 2.0 * np.pi * (9.0 * t_s[:, None] + rng.uniform(size=3))
    place = 0.02 * np.sin(turns)
    out_s = last / RATE_HZ + OUT_AFTER_S
    back_s = rearm / RATE_HZ + 0.6
    knots_s = [out_s, out_s + 0.4, back_s, back_s + 0.4]
    place[:, 0] += np.interp(t_s, knots_s, [REACH_MM, OUT_MM, OUT_MM, REACH_MM])
    return np.asarray(place)


def _run(servoing: Servoing, device: FaultyDevice, rearm: int) -> ServoRecord:
    """All ticks: from one word of the session to the next, or at once where ticks come late."""
    model = wall_model()
    servo = SimulatedServo(Fixtures(model), device, options=servoing.options)
    transform, still = steady_transform(model), Rigid.identity("tracker", "device")
    ticks = len(servoing.late_s)
    if servoing.late_s.any():
        whole = ServoInputs(transform, 0.0, still, valid_for_s=10.0 * ticks / RATE_HZ)
        before = [servo.run(whole, rearm, servoing.late_s[:rearm])]
        servo.ask_rearm()
        return _joined([*before, servo.run(whole, ticks - rearm)])
    rows, inputs = [], ServoInputs(transform, 0.0, still)
    step = round(RATE_HZ * PUBLISH_S)
    for at in range(0, ticks, step):
        if servoing.publishing[at]:
            inputs = replace(inputs, now_s=servo.now_s)
        if at <= rearm < at + step:
            servo.ask_rearm()
        rows.append(servo.run(inputs, min(step, ticks - at)))
    return _joined(rows)


def _joined(records: list[ServoRecord]) -> ServoRecord:
    return ServoRecord(np.concatenate([record.rows for record in records]))


def _course(record: ServoRecord, device: FaultyDevice) -> TrialTrace:
    """Forces sent to the device, by ticks and by the watchdog between two ticks."""
    sent = device.sent
    tick = np.searchsorted(record.t_s, sent[:, 0] - 1e-7)
    by_tick = np.abs(record.t_s[np.minimum(tick, len(record) - 1)] - sent[:, 0]) < 1e-6
    tick = np.minimum(tick, len(record) - 1)
    wanted_n = np.linalg.norm(record.wanted_n, axis=1)
    return TrialTrace(
        np.where(by_tick, record.t_s[tick], sent[:, 0]),
        np.where(by_tick, record.hazards[tick], int(Hazard.MISSED_DEADLINES)),
        np.where(by_tick, record.state[tick], int(SupervisorState.LATCHED)),
        np.linalg.norm(sent[:, 1:], axis=1),
        np.where(np.isfinite(wanted_n), wanted_n, 0.0)[tick],
        np.zeros(len(sent)),
    )


def _energy_passes(record: ServoRecord, options: ServoOptions) -> float:
    """When Σ [F_sent − ½(F_k + F_{k−1})]·Δx, never below 0, passes the limit; the wall stands still."""
    moved = np.diff(record.xyz_mm, axis=0)
    ideal = 0.5 * (record.field_n[1:] + record.field_n[:-1])
    energy = ((record.sent_n[:-1] - ideal) * moved).sum(axis=1)
    total = 0.0
    for k in np.flatnonzero(record.t_s[1:] > BEGIN_S).tolist():
        total = max(0.0, total + float(energy[k]))
        if total > options.residual_limit_mj:
            return float(record.t_s[k + 1])
    return float("inf")


# ------------------------------------------------------------------ faults


def place_not_finite(servoing: Servoing, first: int, last: int, rng: np.random.Generator) -> None:
    """The device reports NaN."""
    servoing.place_mm[first:last, int(rng.integers(3))] = np.nan


def device_silent(servoing: Servoing, first: int, last: int, rng: np.random.Generator) -> None:
    """The device does not answer."""
    servoing.silent[first:last] = True


def session_silent(servoing: Servoing, first: int, last: int, rng: np.random.Generator) -> None:
    """The session does not speak; it began with its last word."""
    step = round(RATE_HZ * PUBLISH_S)
    servoing.publishing[first:last] = False
    servoing.onset = step * (first // step)


def jumps(by_mm: float, every_s: float) -> Change:
    """The device's place jumps to and fro across the wall's surface."""

    def change(servoing: Servoing, first: int, last: int, rng: np.random.Generator) -> None:
        count = round(RATE_HZ * every_s)
        side = np.where((np.arange(last - first) // count) % 2 == 0, 0.5, -0.5)
        servoing.place_mm[first:last, 0] = by_mm * side

    return change


def late_ticks(by_s: float, count: int, every: int) -> Change:
    """So many ticks, one in `every`, wake late; it begins with the last of them."""

    def change(servoing: Servoing, first: int, last: int, rng: np.random.Generator) -> None:
        at = first + every * np.arange(count)
        servoing.late_s[at] = by_s
        servoing.onset = int(at[-1])

    return change


def trembling(by_mm: float, rate_hz: float) -> Change:
    """A hand that trembles in the wall, with the passivity controller switched off."""

    def change(servoing: Servoing, first: int, last: int, rng: np.random.Generator) -> None:
        t_s = np.arange(last - first) / RATE_HZ
        servoing.place_mm[first:last, 0] = by_mm * np.sin(2.0 * np.pi * rate_hz * t_s)
        servoing.options = replace(servoing.options, largest_damping_n_s_per_m=0.0)

    return change
