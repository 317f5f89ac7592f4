"""What one heart of the second world draws from the table of ranges."""

import math
from dataclasses import dataclass
from typing import Literal

from data_synth.seeds import child_rng
from dvf_ig.core import InvalidInputError

from .ranges import RANGES

Quality = Literal["calm", "poor-image"]
QUALITIES: tuple[Quality, ...] = ("calm", "poor-image")

SEVERITY: dict[Quality, tuple[float, float]] = {"calm": (0.0, 0.6), "poor-image": (0.4, 1.0)}
"""Share of the way from the mild to the severe end of a range within which each quality draws."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """What one heart of the second world drew: `drawn["image.persistence"]`.

    Every value has a random generator of its own, chosen by its name.
    """

    seed: int
    quality: Quality

    def __post_init__(self) -> None:
        if self.seed < 0 or self.quality not in QUALITIES:
            raise InvalidInputError(
                f"seed {self.seed}, quality '{self.quality}'; needed a non-negative seed and one of "
                f"{', '.join(QUALITIES)}"
            )

    def __getitem__(self, name: str) -> float:
        known, rng = RANGES[name], child_rng(self.seed, f"second world {name}")
        share = float(rng.uniform())
        if known.graded:
            mild, severe = SEVERITY[self.quality]
            share = mild + share * (severe - mild)
        low, high = known.low, known.high
        if known.log:
            size = math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
        else:
            size = low + share * (high - low)
        return size * float(rng.choice((-1.0, 1.0))) if known.either_sign else size

    def choice(self, name: str, weights: dict[str, float]) -> str:
        """One of the keys of `weights`, as often as their values say."""
        names = list(weights)
        share = [weights[key] / sum(weights.values()) for key in names]
        return str(child_rng(self.seed, f"second world {name}").choice(names, p=share))

    def table(self) -> dict[str, float]:
        """Every value, by name."""
        return {name: self[name] for name in RANGES}
