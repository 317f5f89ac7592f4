"""R peaks from the trigger output of a monitor or scanner instead of an ECG."""

from dvf_ig.core import InvalidInputError, TriggerTimes
from dvf_ig.core.timing.trigger import check_trigger_delay

from .lead_off import LeadChange
from .phase_clock import SAME_BEAT_S
from .rpeak import RPeak

SHORTEST_INTERVAL_S = SAME_BEAT_S
"""Shortest time between pulses of two heart beats (240 per minute)."""


class TriggerDetector:
    """R peaks from trigger pulses.

    Pulses too close to be beats do not show which of them is R, so the trigger counts as lost until the next
    one, as an ECG does while its electrodes are off.
    """

    def __init__(self, delay_s: float = 0.0) -> None:
        """Set `delay_s`, the time by which the device fires after the R peak.

        Raises:
            InvalidInputError: a delay outside 0 to 0.5 s.
        """
        check_trigger_delay(delay_s)
        self._delay_s = delay_s
        self._last_s = float("-inf")
        self._changes: list[LeadChange] = []

    def push(self, t_s: float) -> list[RPeak]:
        """Take the next pulse and return its R peak, `delay_s` before it; none for a double pulse.

        Raises:
            InvalidInputError: the pulse comes before the last one.
        """
        if t_s < self._last_s:
            raise InvalidInputError(
                f"a trigger at {t_s:.4f} s came after the one at {self._last_s:.4f} s; feed them in order"
            )
        double = t_s - self._last_s < SHORTEST_INTERVAL_S
        self._last_s = t_s
        if double:
            self._changes += [LeadChange(t_s, False, "double pulse"), LeadChange(t_s, True)]
            return []
        return [RPeak(t_s - self._delay_s, t_s, 1.0)]

    def take_lead_changes(self) -> list[LeadChange]:
        """Return losses and returns of the trigger since the last call, in order of time."""
        changes, self._changes = self._changes, []
        return changes


def trigger_peaks(trigger: TriggerTimes) -> tuple[tuple[RPeak, ...], tuple[LeadChange, ...]]:
    """Return R peaks of a recorded trigger, and when it was lost and came back."""
    detector = TriggerDetector(trigger.delay_s)
    peaks = [peak for t_s in trigger.t_s.tolist() for peak in detector.push(t_s)]
    return tuple(peaks), tuple(detector.take_lead_changes())
