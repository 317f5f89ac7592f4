"""The arrays that a servo's loop shares with Python: fixtures, device, published inputs, flags and counts."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dvf_ig.guidance.device import DeviceLimits
from dvf_ig.guidance.devices.protocol import HapticDevice
from dvf_ig.guidance.fixtures import Fixtures
from dvf_ig.kernels.servo import loop as kernel
from dvf_ig.kernels.servo import shared
from dvf_ig.kernels.servo.layout import Bound, Scratch, new_published, new_scratch, row_words

from .bound import bind_fixtures
from .inputs import Publication, ServoInputs
from .options import ServoOptions
from .record import BINS

SILENT_TIMES_LATE = 5
"""A gap between two forces that latches at once, in lateness of a tick of which three in a hundred latch."""


@dataclass(slots=True, eq=False)
class LoopArrays:
    """Arrays that `dvf_ig.kernels.servo.loop.run_servo` reads and writes from its first tick to its last.

    Attributes:
        bound: fixtures and settings (`bind_fixtures`).
        functions: (2,) int64 addresses of the device's read and write; `context`: the device's own.
        counter, published: words of `Published`, what the session published, under a sequence lock.
        publication: what is published next.
        numbers: (NUMBERS,) int64 flags and counts; `histogram`: (BINS,) int64 of lateness.
        period_ns: of a tick.
    """

    bound: Bound
    functions: Any
    context: Any
    counter: Any
    published: Any
    publication: Publication
    numbers: Any
    histogram: Any
    period_ns: int

    @classmethod
    def of(
        cls,
        fixtures: Fixtures,
        device: HapticDevice,
        limits: DeviceLimits,
        options: ServoOptions,
        *,
        late_ns: int,
        watched: bool,
    ) -> "LoopArrays":
        """Arrays of a loop in which nothing has been published: no pose is known.

        Args:
            fixtures, device, limits, options: as of `Servo`.
            late_ns: what counts as a late tick; SILENT_TIMES_LATE of it without a force latches.
            watched: a watchdog sends no force while the loop hangs.
        Raises:
            InvalidInputError: as `bind_fixtures`.
        """
        numbers = np.zeros(kernel.NUMBERS, dtype=np.int64)
        numbers[kernel.LATE_NS], numbers[kernel.SILENT_NS] = late_ns, SILENT_TIMES_LATE * late_ns
        numbers[kernel.WATCHED] = watched
        return cls(
            bind_fixtures(fixtures, limits, options, device.latency_s, in_hand=True),
            np.array(device.functions, dtype=np.int64),
            device.context,
            shared.new_counter(),
            _nothing_published(),
            Publication(),
            numbers,
            np.zeros(BINS, dtype=np.int64),
            options.period_ns,
        )

    def on_device(self, device: HapticDevice) -> "LoopArrays":
        """Copy for another device: same fixtures and inputs, own flags and counts.

        For a loop that has not run.
        """
        return replace(
            self,
            functions=np.array(device.functions, dtype=np.int64),
            context=device.context,
            numbers=self.numbers.copy(),
            histogram=np.zeros_like(self.histogram),
        )

    def unused(self) -> "LoopArrays":
        """Copy for a loop that has not run, in which nothing has been published."""
        numbers = np.zeros_like(self.numbers)
        columns = [kernel.LATE_NS, kernel.SILENT_NS, kernel.WATCHED]
        numbers[columns] = self.numbers[columns]
        return replace(
            self,
            counter=shared.new_counter(),
            published=_nothing_published(),
            publication=Publication(),
            numbers=numbers,
            histogram=np.zeros_like(self.histogram),
        )

    def new_scratch(self) -> Scratch:
        """Memory before the first tick, and working space."""
        return new_scratch(len(self.bound.packed))

    def publish(self, inputs: ServoInputs, clock_s: float) -> None:
        """Hand the loop what the session knows at `clock_s` of the loop's clock; never waits."""
        new = self.publication
        changed = new.set(inputs, clock_s)
        shared.publish(self.counter, self.published, new.words if changed else new.head)

    def arguments(
        self, scratch: Scratch, rows: Any, start_ns: int = 0, late_ns: Any = None
    ) -> tuple[Any, ...]:
        """Arguments of `run_servo`.

        Args:
            scratch: of `new_scratch`.
            rows: (n,) ROW, ring buffer of the record.
            start_ns, late_ns: in simulated time, deadline of the first tick and (m,) int64 lateness of each.
        """
        simulated_late_ns = np.zeros(0, dtype=np.int64) if late_ns is None else late_ns
        return (
            self.bound,
            scratch,
            self.functions,
            self.context,
            self.counter,
            self.published,
            self.numbers,
            row_words(rows),
            self.histogram,
            self.period_ns,
            start_ns,
            simulated_late_ns,
        )


def _nothing_published() -> Any:
    """Words of `Published` without a pose."""
    published = new_published()
    inputs = published.inputs
    inputs["valid_until_s"], inputs["pose_and_phase"]["pose_until_s"] = np.inf, -np.inf
    return published.words
