"""Specification of a heart: its kind, and the seeds of variation between people and interventions."""

from dataclasses import dataclass
from typing import Literal, get_args

from dvf_ig.core import InvalidInputError

HeartKind = Literal["standard", "varied", "healthy", "dilated", "hypertrophic"]
"""standard: one left ventricle for all seeds, in closed form; varied: drawn from `population.POPULATION`."""

HEART_KINDS: tuple[HeartKind, ...] = get_args(HeartKind)


@dataclass(frozen=True, slots=True)
class HeartSeeds:
    """Seeds of all random parts; see `HeartSpec`."""

    anatomy: int
    motion: int
    mismatch: int
    speckle: int


@dataclass(frozen=True, slots=True)
class HeartSpec:
    """Heart and its images; each seed left None is the seed of the scenario or pair.

    Two specifications that agree in `kind` and in a seed agree in what that seed draws, independent of the
    other
    seeds: the same anatomy under another mismatch, the same heart in other speckle.

    Attributes:
        kind: kind of heart.
        anatomy_seed: size and shape at end-diastole, and position in the thorax.
        motion_seed: contractility, timing and twist; without effect on the standard heart.
        mismatch_seed: difference between pre-operative and intra-operative anatomy.
        speckle_seed: scatterers and noise of the ultrasound images.
    """

    kind: HeartKind = "standard"
    anatomy_seed: int | None = None
    motion_seed: int | None = None
    mismatch_seed: int | None = None
    speckle_seed: int | None = None

    def __post_init__(self) -> None:
        if self.kind not in HEART_KINDS:
            raise InvalidInputError(
                f"there is no kind of heart '{self.kind}'; choose from {', '.join(HEART_KINDS)}"
            )
        if any(seed_given is not None and seed_given < 0 for seed_given in self._given()):
            raise InvalidInputError(f"the heart's seeds are {self._given()}; needed non-negative integers")

    def seeds(self, seed: int) -> HeartSeeds:
        """Return all seeds, with `seed` for those left open."""
        return HeartSeeds(*(seed if seed_given is None else seed_given for seed_given in self._given()))

    def _given(self) -> tuple[int | None, ...]:
        return self.anatomy_seed, self.motion_seed, self.mismatch_seed, self.speckle_seed


STANDARD_HEART = HeartSpec()
"""Standard heart with all seeds those of the scenario or pair."""
