"""Sampled signals: a multi-lead ECG, a single trace with its own time stamps, and breathing."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core.arrays import FloatArray, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """Uniformly sampled recording, one column a lead.

    Attributes:
        samples: (n, leads) in `unit`; NaN marks samples the recorder did not deliver.
        rate_hz: sampling rate.
        start_s: time of sample 0 on the recording's clock.
        leads: lead names.
        unit: physical unit, normally "mV".
        left_out: channels of the recording that were not taken as leads.
    """

    samples: FloatArray
    rate_hz: float
    start_s: float
    leads: tuple[str, ...]
    unit: str = "mV"
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        samples = frozen_floats(self.samples, "signal", (None, len(self.leads)), finite=False)
        if len(samples) < 2:
            raise InvalidInputError(f"the signal has {len(samples)} samples; needed at least 2")
        if not 1.0 <= self.rate_hz <= 100_000.0:
            raise InvalidInputError(f"sampling rate is {self.rate_hz:g} Hz; needed 1 to 100 000 Hz")
        object.__setattr__(self, "samples", samples)

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def t_s(self) -> FloatArray:
        """(n,) sample times."""
        return self.start_s + np.arange(len(self.samples)) / self.rate_hz

    def between(self, start_s: float, stop_s: float) -> "Signal":
        """Cut out the samples with start_s <= t < stop_s."""
        first = max(0, int(np.ceil((start_s - self.start_s) * self.rate_hz - 1e-9)))
        last = min(len(self), int(np.ceil((stop_s - self.start_s) * self.rate_hz - 1e-9)))
        if last - first < 2:
            raise InvalidInputError(f"no signal between {start_s:g} s and {stop_s:g} s")
        return Signal(
            self.samples[first:last],
            self.rate_hz,
            self.start_s + first / self.rate_hz,
            self.leads,
            self.unit,
            self.left_out,
        )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Scalar against its own, possibly uneven, time stamps: (n,) each, time strictly increasing."""

    t_s: FloatArray
    values: FloatArray

    def __post_init__(self) -> None:
        t_s = frozen_floats(self.t_s, "trace times", (None,))
        values = frozen_floats(self.values, "trace values", (len(t_s),))
        if (np.diff(t_s) <= 0).any():
            raise InvalidInputError("trace times do not increase strictly; drop repeated samples")
        object.__setattr__(self, "t_s", t_s)
        object.__setattr__(self, "values", values)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Respiration:
    """What follows the breath, on the tracker's clock.

    Attributes:
        t_s: (n,) increasing.
        values: (n, columns): one of a monitor or ventilator, three (mm) of a marker.
        name: of the channel or marker.
    """

    t_s: FloatArray
    values: FloatArray
    name: str

    def __post_init__(self) -> None:
        t_s = frozen_floats(self.t_s, "times of breathing", (None,))
        object.__setattr__(self, "t_s", t_s)
        object.__setattr__(
            self, "values", frozen_floats(self.values, "values of breathing", (len(t_s), None))
        )
        if len(t_s) < 2 or (np.diff(t_s) <= 0).any():
            raise InvalidInputError("times of breathing do not increase, or there are fewer than two")

    def __len__(self) -> int:
        return len(self.t_s)
