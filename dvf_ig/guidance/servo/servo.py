"""Servo of a haptic device: starts, feeds and ends the real-time loop."""

import copy
import os
import sys
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import numpy as np

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance.device import COMMON_DEVICE, DeviceLimits
from dvf_ig.guidance.devices.protocol import HapticDevice
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.evaluator import Evaluator
from dvf_ig.guidance.fixtures import Fixtures
from dvf_ig.guidance.sideways import check_sideways
from dvf_ig.guidance.supervision.hazards import Hazard
from dvf_ig.guidance.supervision.supervisor import RearmAnswer, SupervisorState
from dvf_ig.kernels.servo import loop as kernel
from dvf_ig.kernels.servo import shared
from dvf_ig.kernels.servo.layout import ROW, row_words

from .bound import REARM_ANSWERS
from .inputs import ServoInputs
from .loop_arrays import LoopArrays
from .options import ServoOptions
from .record import Deadlines, SentForce, ServoRecord

PRIORITY = 80


def real_time_thread(
    name: str, function: Callable[..., Any], *arguments: Any
) -> tuple[threading.Thread, bool]:
    """A running thread, and whether it has a real-time priority (Linux: root, or an rtprio limit)."""
    thread = threading.Thread(target=function, args=arguments, name=name, daemon=True)
    thread.start()
    try:
        os.sched_setscheduler(thread.native_id or 0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        return thread, False
    return thread, True


CHECK_NS = 1_000_000
LATE_NS = 2_000_000
"""Three ticks in a hundred that wake or end so late latch, and 10 ms without a force (SILENT_TIMES_LATE)."""
KEPT_S = 2.0
"""The ring buffer holds the last so many seconds."""
ANSWER_WITHIN_S = 0.1
WARM_UP_TICKS = 20


class Servo:
    """Reads a haptic device, evaluates the fixtures and sends the supervised force, once a period.

    A context manager: entered, it warms up and begins to tick; left, it stops and sends no force. Forces
    begin after the first `publish`, from zero, at 6 N/s. One thread publishes, re-arms and reads.

    Args:
        fixtures: on the patient's model.
        device: open.
        limits: of the device; the stiffness gives the slew limit.
        options: rate, damping, passivity.
        watchdog: a second thread that sends no force while the loop hangs; its servo is not re-armed.
        late_s: three ticks in a hundred that wake or end so late latch, and so does five times that without a
            force; longer only where nobody feels the force at the servo's rate.
    Raises:
        InvalidInputError: another system than Linux, fixtures that the servo does not render, or such as the
            device does not (`check_sideways`).
    """

    def __init__(
        self,
        fixtures: Fixtures,
        device: HapticDevice,
        *,
        limits: DeviceLimits = COMMON_DEVICE,
        options: ServoOptions = ServoOptions(),  # noqa: B008  frozen
        watchdog: bool = True,
        late_s: float = LATE_NS * 1e-9,
    ) -> None:
        if sys.platform != "linux":
            raise InvalidInputError(
                f"the servo needs Linux, which sleeps until an absolute time; this is {sys.platform}"
            )
        self.device, self.options = device, options
        late_ns = round(late_s * 1e9)
        self._loop = LoopArrays.of(fixtures, device, limits, options, late_ns=late_ns, watched=watchdog)
        for part in fixtures.parts:
            if isinstance(part, Evaluator):
                check_sideways(part, limits)
        self._ring = np.zeros(max(1024, round(KEPT_S * options.rate_hz)), ROW)
        self._watchdog = watchdog
        self._threads: list[threading.Thread] = []
        self.realtime = False
        """The machine schedules this servo before all ordinary programs."""
        self._read_to = 0
        self._latched = False

    def successor(self) -> "Servo":
        """Return a servo for the same device and fixtures, once this one has ended.

        It begins latched: after a watchdog has tripped, an operator's `rearm` of it gives a force again.
        """
        new = copy.copy(self)
        new._loop, new._ring, new._threads = self._loop.unused(), np.zeros_like(self._ring), []
        new._read_to, new._latched = 0, True
        return new

    def __enter__(self) -> "Servo":
        if self._threads or self._loop.numbers[kernel.STOP]:
            raise InvalidInputError("a servo runs once; make a new one")
        loop = self._loop
        self._warm_up()
        scratch = loop.new_scratch()
        if self._latched:
            memory = scratch.memory["supervision"]
            memory["state"], memory["cause"] = SupervisorState.LATCHED, Hazard.MISSED_DEADLINES
        self._begin("dvf-ig servo", kernel.run_servo, *loop.arguments(scratch, self._ring))
        if self._watchdog:
            watched = (loop.functions, loop.context, loop.numbers)
            self._begin("dvf-ig watchdog", kernel.watch, *watched, CHECK_NS)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.withdraw()
        for thread in self._threads:
            thread.join()

    def publish(self, inputs: ServoInputs, clock_s: float | None = None) -> None:
        """Hand the servo what the session knows; never waits.

        Args:
            clock_s: the machine's monotonic clock at `inputs.now_s`; None: now.
        """
        self._loop.publish(inputs, time.monotonic_ns() * 1e-9 if clock_s is None else clock_s)

    def withdraw(self) -> None:
        """Stop for good: the next tick sends no force; from any thread, also within a signal's handler."""
        shared.store_number(self._loop.numbers, kernel.STOP, 1)

    def rearm(self) -> RearmAnswer:
        """An operator's request to leave LATCHED, judged by the servo in its next tick.

        A servo whose watchdog has tripped is not re-armed: end it, and re-arm its `successor`.
        """
        request = shared.load_number(self._loop.numbers, kernel.REARM_ASKED) + 1
        shared.store_number(self._loop.numbers, kernel.REARM_ASKED, request)
        until = time.monotonic() + ANSWER_WITHIN_S
        while shared.load_number(self._loop.numbers, kernel.REARM_ANSWERED) < request:
            if time.monotonic() > until:
                return RearmAnswer.NO_RECENT_STEP
            time.sleep(0.5 / self.options.rate_hz)
        return REARM_ANSWERS[shared.load_number(self._loop.numbers, kernel.REARM_ANSWER)]

    def read(self) -> ServoRecord:
        """The ticks since the last call, or as many of them as the ring buffer still holds."""
        head = shared.load_number(self._loop.numbers, kernel.HEAD)
        begin = max(self._read_to, head - len(self._ring) + 64)
        rows = np.empty(head - begin, ROW)
        kernel.copy_rows(row_words(self._ring), self._loop.numbers, begin, row_words(rows))
        self._read_to = head
        return ServoRecord(rows[np.isfinite(rows["t_s"])])

    def newest(self) -> SentForce | None:
        """The force sent last, with what was met since the last call; None without a tick since then.

        Where no force has been sent for too long it is zero, latched: a stopped process may wake up here
        before the servo does, which then finds the same.
        """
        silent_s = 1e-9 * float(self._loop.numbers[kernel.SILENT_NS])
        sent = self.read().newest()
        while not kernel.silent_too_long(self._loop.numbers, _elapsed_ns()):
            if sent is None or self._now_s() - sent.t_s <= silent_s:
                return sent
            # this thread was stopped since it read: the servo has a newer tick, or is silent
            sent = self.read().newest() or sent
        hazards = Hazard.MISSED_DEADLINES | (sent.hazards if sent is not None else Hazard.NONE)
        return SentForce(self._now_s(), np.zeros(3), SupervisorState.LATCHED, hazards)

    @property
    def silent(self) -> bool:
        """No force has been sent for too long: the last one counts as zero, latched."""
        return bool(kernel.silent_too_long(self._loop.numbers, _elapsed_ns()))

    @property
    def ticks(self) -> int:
        """Number of ticks since the start."""
        return shared.load_number(self._loop.numbers, kernel.HEAD)

    @property
    def watchdog_tripped(self) -> bool:
        """No force had been sent for 10 ms at some time: none is sent until a new servo is started."""
        return shared.load_number(self._loop.numbers, kernel.TRIPPED) != 0

    @property
    def deadlines(self) -> Deadlines:
        """Lateness of all ticks since the start; exact once the servo has stopped."""
        worst, skipped = self._loop.numbers[kernel.WORST_NS], self._loop.numbers[kernel.SKIPPED]
        return Deadlines(self._loop.histogram.copy(), float(worst) / 1e3, int(skipped))

    def _now_s(self) -> float:
        """Time of the session that published last."""
        return time.monotonic_ns() * 1e-9 - float(self._loop.publication.inputs["clock_offset_s"])

    def _begin(self, name: str, function: Callable[..., Any], *arguments: Any) -> None:
        thread, realtime = real_time_thread(name, function, *arguments)
        self._threads.append(thread)
        self.realtime = realtime

    def _warm_up(self) -> None:
        """Compile or load every kernel, and touch the coefficients, before the first tick."""
        bound = self._loop.bound
        for coefficients in (bound.linear, bound.periodic, bound.structures):
            float(np.sum(coefficients))
        published = self._loop.published
        shared.publish(self._loop.counter, published, published.copy())
        nobody = RecordedDevice(np.zeros((WARM_UP_TICKS, 3)), self.options.rate_hz)
        loop, ring = self._loop.on_device(nobody), np.zeros(WARM_UP_TICKS, ROW)
        on_time = np.zeros(WARM_UP_TICKS, dtype=np.int64)
        kernel.run_servo(*loop.arguments(loop.new_scratch(), ring, start_ns=1, late_ns=on_time))
        kernel.copy_rows(row_words(ring), loop.numbers, 0, row_words(np.empty(1, ROW)))
        loop.numbers[kernel.STOP] = 1
        kernel.watch(loop.functions, loop.context, loop.numbers, CHECK_NS)
        kernel.silent_too_long(loop.numbers, _elapsed_ns())


def _elapsed_ns() -> int:
    """Time by `dvf_ig.kernels.servo.clock.elapsed_ns`."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)
