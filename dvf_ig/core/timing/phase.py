"""The heart's clock as a value: phase, its uncertainty and its state over time."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from dvf_ig.core.arrays import BoolArray, FloatArray, IntArray, frozen, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError


class PhaseState(IntEnum):
    """State of the cardiac phase; only with LOCKED may it be used."""

    INIT = 0
    LOCKED = 1
    SUSPECT = 2
    LOST = 3
    IRREGULAR = 4


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PhaseTrack:
    """Phase at each time, as estimated from the past alone.

    Attributes:
        t_s: (n,) increasing.
        phi: (n,) in [0, 1), fraction of the RR interval since the last R peak.
        sigma_phi: (n,) one standard deviation of phi.
        rr_s: (n,) predicted length of the running beat.
        state: (n,) PhaseState values.
    """

    t_s: FloatArray
    phi: FloatArray
    sigma_phi: FloatArray
    rr_s: FloatArray
    state: IntArray

    def __post_init__(self) -> None:
        t_s = frozen_floats(self.t_s, "phase times", (None,))
        n = len(t_s)
        if (np.diff(t_s) <= 0).any():
            raise InvalidInputError("phase times do not increase strictly")
        object.__setattr__(self, "t_s", t_s)
        for name in ("phi", "sigma_phi", "rr_s"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), name, (n,), finite=False))
        object.__setattr__(self, "state", frozen(self.state, "phase state", (n,), np.int64))

    @property
    def valid(self) -> BoolArray:
        """Return (n,) True if the state is LOCKED."""
        return np.asarray(self.state == int(PhaseState.LOCKED))
