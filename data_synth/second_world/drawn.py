"""Values that one heart of the second world draws from the table of ranges."""

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
    """Values drawn for one heart of the second world: `drawn["image.persistence"]`.

    Every value has its own random generator, chosen by its name.
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
        entry, rng = RANGES[name], child_rng(self.seed, f"second world {name}")
        share = float(rng.uniform())
        if entry.graded:
            mild, severe = SEVERITY[self.quality]
            share = mild + share * (severe - mild)
        low, high = entry.low, entry.high
        if entry.log:
            size = math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
        else:
            size = low + share * (high - low)
        return size * float(rng.choice((-1.0, 1.0))) if entry.either_sign else size

    def choice(self, name: str, weights: dict[str, float]) -> str:
        """Draw one of the keys of `weights` with probability in proportion to its value."""
        names = list(weights)
        share = [weights[key] / sum(weights.values()) for key in names]
        return str(child_rng(self.seed, f"second world {name}").choice(names, p=share))

    def table(self) -> dict[str, float]:
        """Return all values by name."""
        return {name: self[name] for name in RANGES}
