"""Recorded breathing: samples of something that follows the breath."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core.arrays import FloatArray, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError


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
