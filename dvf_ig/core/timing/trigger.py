"""Pulses of a hardware trigger (R-wave output of a monitor or scanner) instead of an ECG."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core.arrays import FloatArray, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError

LONGEST_DELAY_S = 0.5


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TriggerTimes:
    """Times at which a trigger fired.

    Attributes:
        t_s: (n,) times of the pulses, in order.
        delay_s: time by which the device fires after the R peak; measure it once, it does not change.
    """

    t_s: FloatArray
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        t_s = frozen_floats(self.t_s, "trigger times", (None,))
        if len(t_s) == 0:
            raise InvalidInputError("the trigger never fired; needed at least 1 time of a pulse")
        if (np.diff(t_s) < 0).any():
            k = int(np.diff(t_s).argmin())
            raise InvalidInputError(
                f"trigger {k + 1} at {t_s[k + 1]:.3f} s comes after the one at {t_s[k]:.3f} s; "
                "order the pulses"
            )
        check_trigger_delay(self.delay_s)
        object.__setattr__(self, "t_s", t_s)

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def start_s(self) -> float:
        """Time of the first pulse."""
        return float(self.t_s[0])


def check_trigger_delay(delay_s: float) -> None:
    """Raise InvalidInputError for an implausible trigger delay."""
    if not 0.0 <= delay_s <= LONGEST_DELAY_S:
        raise InvalidInputError(
            f"the trigger's delay is {delay_s:g} s; needed 0 to {LONGEST_DELAY_S:g} s after R (is it in ms?)"
        )
