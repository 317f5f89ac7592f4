"""Times of the volumes of a 4-D image as its own header states them: their order, and the cycle they span."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, IntArray, UnreadableFileError, read_only_arrays
from dvf_ig.core.plausible import RR_S
from dvf_ig.core.timing.cycle import CycleTiming, require_whole_cycle

log = logging.getLogger(__name__)

_SECONDS = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "microsecond", "microseconds"), 1e-6),
}
_SHARES = {**dict.fromkeys(("%", "%r-r", "%rr", "percent"), 0.01), "rr": 1.0}
"""Shares of the RR interval by unit; "RR" is the unit of the sequences that `replay --export` writes."""
_SAME_FRACTION, _SAME_RR = 0.05, 0.1
"""Largest differences of two statements of one timing: a step of 20 phases, and a tenth of the interval."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PhaseTimes:
    """Times of the stored volumes, in the order in which they are stored.

    Attributes:
        values: (n,) in `unit`.
        unit: as the file writes it; empty if it states none.
        field: of the header, for messages.
        nominal: one step for the whole axis, which programs often leave at a value of no meaning.
    """

    values: FloatArray
    unit: str
    field: str
    nominal: bool = False

    def order(self, path: Path) -> IntArray:
        """Sort the volumes by time.

        Raises:
            UnreadableFileError: two volumes have one time, or a time is not a number.
        """
        order = np.argsort(self.values, kind="stable")
        ordered = self.values[order]
        if not np.isfinite(ordered).all() or (np.diff(ordered) <= 0).any():
            raise UnreadableFileError(
                f"{path}: {self.field} states {self._range()} for {len(ordered)} volumes; needed a time of "
                "its own for each"
            )
        return np.asarray(order, dtype=np.int64)

    def seconds(self, path: Path) -> FloatArray:
        """Convert to seconds, in order of time.

        Raises:
            UnreadableFileError: another unit, or none.
        """
        scale = _SECONDS.get(self.unit.lower())
        if scale is None:
            raise UnreadableFileError(
                f"{path}: {self.field} is in '{self.unit[:20]}'; needed times in s or ms: state the unit"
            )
        return self.values[self.order(path)] * scale

    def fractions(self, path: Path) -> FloatArray | None:
        """Return increasing fractions of the RR interval; None if the values have another unit.

        Raises:
            UnreadableFileError: outside [0, 1).
        """
        share = _SHARES.get(self.unit.lower())
        if share is None:
            return None
        fractions = self.values[self.order(path)] * share
        if fractions[0] < 0 or fractions[-1] >= 1:
            raise UnreadableFileError(
                f"{path}: {self.field} states {self._range()}; needed fractions of one RR interval, 0 to "
                "below 1 (100 %): give --timing"
            )
        return fractions

    def timing(self, path: Path) -> CycleTiming | None:
        """Compute the timing of one cycle that ends a mean step after its last volume; None without times.

        Without a unit, s or ms is chosen by which gives the length of a heart's cycle; numbers 0, 1, 2, …
        only order the volumes.

        Raises:
            UnreadableFileError: times in a stated unit that are not those of one cycle.
        """
        values = self.values[self.order(path)]
        count = len(values)
        if (fractions := self.fractions(path)) is not None:
            require_whole_cycle(fractions, self.field)
            return CycleTiming(fractions, 1.0, rr_assumed=True)
        if self.unit and self._scale() is None:
            log.warning(
                "%s: %s is in '%s', which is no unit of time: not used", path, self.field, self.unit[:20]
            )
            return None
        if count < 2 or (not self._scale() and (np.diff(values) == 1).all()):
            return None
        step = float(np.diff(values).mean())
        since_peak = 0 <= values[0] < 2 * step  # else counted from another event
        times = values if since_peak else values - values[0]
        scale = self._scale() or next((s for s in (1.0, 1e-3) if _is_cycle(s * (times[-1] + step))), None)
        if scale is None or (self.nominal and not _is_cycle(scale * float(times[-1] + step))):
            log.warning(
                f"{path}: {self.field} states times of {self._range()}, which are no cycle of a heart: not "
                "used"
            )
            return None
        rr_s = scale * float(times[-1] + step)
        if not _is_cycle(rr_s):
            raise UnreadableFileError(
                f"{path}: {self.field} states {self._range()}, a cycle of {rr_s:.4g} s; a heart's has "
                f"{RR_S[0]:g} to {RR_S[1]:g} s: correct the unit, cut it to one cycle, or give --timing"
            )
        return CycleTiming(times * scale / rr_s, rr_s, rr_assumed=True)

    def _scale(self) -> float | None:
        return _SECONDS.get(self.unit.lower())

    def _range(self) -> str:
        return f"{self.values.min():g} to {self.values.max():g} {self.unit[:20]}".rstrip()


def uniform_times(step: float, count: int, unit: str, field: str) -> PhaseTimes | None:
    """Build times of equal steps; None for a step of 0 or 1, which writers store if they know none."""
    if not np.isfinite(step) or step in (0.0, 1.0) or count < 2:
        return None
    return PhaseTimes(step * np.arange(count, dtype=np.float64), unit, field, nominal=True)


def require_same_timing(path: Path, header: CycleTiming, file: Path, timing: CycleTiming) -> None:
    """Refuse a timing file that contradicts the times in an image's own header.

    Raises:
        UnreadableFileError: another number of phases, other fractions, or another RR interval.
    """
    if len(header) != len(timing):
        return  # the reader of the series states both numbers
    apart = float(np.abs(header.fractions - timing.fractions).max())
    if apart > _SAME_FRACTION or abs(header.rr_s / timing.rr_s - 1) > _SAME_RR:
        raise UnreadableFileError(
            f"{path} states a cycle of {header.rr_s:.4g} s, {file.name} in its folder {timing.rr_s:.4g} s, "
            f"with phases up to {100 * apart:.0f} % of the cycle apart; correct one, or choose with --timing"
        )


def _is_cycle(seconds: float) -> bool:
    return RR_S[0] <= seconds <= RR_S[1]
