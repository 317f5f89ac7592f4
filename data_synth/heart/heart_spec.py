"""Which heart is meant: its kind, and the seeds of what varies between people and between interventions."""

from dataclasses import dataclass
from typing import Literal, get_args

from dvf_ig.core import InvalidInputError

HeartKind = Literal["standard", "varied", "healthy", "dilated", "hypertrophic"]
"""standard: one left ventricle for all seeds, in closed form; varied: drawn from `population.POPULATION`."""

HEART_KINDS: tuple[HeartKind, ...] = get_args(HeartKind)


@dataclass(frozen=True, slots=True)
class HeartSeeds:
    """The seed of each thing that is drawn; see `HeartSpec`."""

    anatomy: int
    motion: int
    mismatch: int
    speckle: int


@dataclass(frozen=True, slots=True)
class HeartSpec:
    """A heart and its images; each seed that is left None is the seed of the scenario or pair.

    Two specifications that agree in `kind` and in a seed agree in what that seed draws, whatever the others
    are: the same anatomy under another mismatch, the same heart in other speckle.

    Attributes:
        kind: of heart.
        anatomy_seed: size and shape at end-diastole, and place in the thorax.
        motion_seed: contractility, timing and twist; of no effect on the standard heart.
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
        if any(given is not None and given < 0 for given in self._given()):
            raise InvalidInputError(f"the heart's seeds are {self._given()}; needed non-negative integers")

    def seeds(self, seed: int) -> HeartSeeds:
        """Every seed, those left open being `seed`."""
        return HeartSeeds(*(seed if given is None else given for given in self._given()))

    def _given(self) -> tuple[int | None, ...]:
        return self.anatomy_seed, self.motion_seed, self.mismatch_seed, self.speckle_seed


STANDARD_HEART = HeartSpec()
"""The standard heart, every seed that of the scenario or pair."""
