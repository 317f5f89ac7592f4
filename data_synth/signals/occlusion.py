"""Blocking of the tracker's line of sight while the tool touches the heart."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import InvalidInputError, ToolTruth

Intervals = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class OcclusionSpec:
    """Long losses of one marker.

    Attributes:
        losses_per_min: number a minute; at least one in a recording if not 0.
        loss_s: (shortest, longest) loss.
    """

    losses_per_min: float = 0.0
    loss_s: tuple[float, float] = (1.5, 4.0)

    def __post_init__(self) -> None:
        if self.losses_per_min < 0 or not 0 < self.loss_s[0] <= self.loss_s[1]:
            raise InvalidInputError(
                f"{self.losses_per_min:g} losses a minute of {self.loss_s[0]:g} to {self.loss_s[1]:g} s; "
                "needed a non-negative number, and positive, increasing lengths"
            )


def losses_in_contact(contact: ToolTruth, spec: OcclusionSpec, rng: np.random.Generator) -> Intervals:
    """Draw (start, stop) of every loss, each around a time of true contact.

    The times are spread over all the time in contact (without any, over the whole recording): each is in
    the middle third of an equal share of it.
    """
    if spec.losses_per_min == 0:
        return ()
    minutes = float(contact.t_s[-1] - contact.t_s[0]) / 60.0
    count = max(1, round(spec.losses_per_min * minutes))
    touching = contact.t_s[contact.distance_mm >= 0]
    moments = touching if len(touching) >= count else contact.t_s
    out = []
    for group in np.array_split(moments, count):
        middle = group[len(group) // 3 : len(group) - len(group) // 3]
        moment, length = float(rng.choice(middle)), float(rng.uniform(*spec.loss_s))
        start = moment - length * float(rng.uniform(0.2, 0.8))
        out.append((start, start + length))
    return tuple(out)
