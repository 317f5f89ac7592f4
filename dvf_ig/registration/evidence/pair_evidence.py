"""Evidence for the pose of a pair of images of an organ that does not beat."""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Stop, read_only_arrays

USUAL_MM = 1.05
"""Error predicted by parts of the ultrasound that is evidence neither for nor against a pose."""
USUAL_STARTS = 0.1
"""Neutral share of agreeing starts: with 32, three."""
USUAL_SHARE = 0.65
"""Neutral share of LC2, above chance, that the next best pose has."""
LEAST_SHARE = 0.4
"""The next best pose's share counts as no less: that no start ended elsewhere is no proof that nothing else
explains the image. On tuning pairs (brains 1021–1032, cines 002, 003, 008, 009) it costs one good pose in 336
and refuses two more of 28 that are 2 to 3 mm off."""
USUAL_Z = 6.5
"""Neutral number of standard deviations above poses 15 mm away. Good brains (FLAIR, T1) have 11 or more,
wrong poses and other patients' brains 4.3 or less: their middle is 7.0; good poses of real cines 6.9 or more,
wrong ones 6.1 or less: 6.5. Each family's middle parts the other one's poses. Height is evidence against a
pose, never for it: a wrong one can stand high where another explains as much."""
START_SIGMA_MM = 10.0
"""Standard deviation of a start's error: a pose far from it is less likely, which decides where an image says
little (tuning pair 1015 with a fifth of the usual contrast). A wrong anatomy can have a pose that agrees with
itself (mirrored MR of four lobes, 12 mm away)."""
PARTS_WEIGHT, STARTS_WEIGHT, SHARE_WEIGHT, Z_WEIGHT = 3.5, 0.7, 6.0, 8.0
"""Weights of their log-odds. Chosen on brains 1001, 1006, 1013, 1015, 1018, 1020 and real cines 002 and
003: with the first three alone, fitted on brains, a pose of cine 002 that is 5.4 mm off and that half of
the starts reach was accepted."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PairEvidence:
    """Consistency of a pose with itself; see `pairs.check`.

    Attributes:
        agreeing_starts: share of the displaced starts that ended at the pose, at least one start's.
        similarity: LC2 at the pose; chance: its mean at poses where nothing is registered.
        elsewhere: (k,) LC2 of the best other poses, 4 mm or more away, best first; none where all agree.
        jackknife_mm: RMS error over the fan that the spread of poses, each with one part of the ultrasound
            left out, predicts.
        halves_mm: mean distance over the fan between the optima of two interleaved halves.
        z_score: standard deviations by which LC2 stands above poses 15 mm away.
        moved_mm: mean distance over the fan from the start.
        mirrored_share: LC2 of the best mirrored anatomy over that of the anatomy; for information.
    """

    agreeing_starts: float
    similarity: float
    chance: float
    elsewhere: FloatArray
    jackknife_mm: float
    halves_mm: float
    z_score: float
    moved_mm: float
    mirrored_share: float

    @property
    def next_best_share(self) -> float:
        """Explanation by the best other pose beyond chance, as a share of that by the pose."""
        if not len(self.elsewhere):
            return 0.0
        share = (self.elsewhere[0] - self.chance) / max(self.similarity - self.chance, 1e-12)
        return float(np.clip(share, 0.0, 1.0))

    @property
    def parts_mm(self) -> float:
        """Error that the disagreement of parts predicts: the mean square of jack-knife and halves."""
        return math.sqrt(0.5 * (self.jackknife_mm**2 + self.halves_mm**2))

    @property
    def doubts(self) -> tuple[float, float, float, float, float]:
        """Log-odds against the pose from parts, starts, the next best pose, poses far away and the way."""
        return (
            PARTS_WEIGHT * math.log(max(self.parts_mm, 0.05) / USUAL_MM),
            -STARTS_WEIGHT * math.log(self.agreeing_starts / USUAL_STARTS),
            SHARE_WEIGHT * (max(self.next_best_share, LEAST_SHARE) - USUAL_SHARE),
            max(-Z_WEIGHT * math.log(max(self.z_score, 0.5) / USUAL_Z), 0.0),
            0.5 * (self.moved_mm / START_SIGMA_MM) ** 2,
        )

    @property
    def doubt(self) -> float:
        """Log-odds that the mean error is not below 2 mm; above 0 the pose must not guide."""
        return sum(self.doubts)

    @property
    def success_probability(self) -> float:
        """Chance that the mean error is below 2 mm."""
        return 1.0 / (1.0 + math.exp(min(max(self.doubt, -30.0), 30.0)))

    @property
    def stop(self) -> Stop:
        """Whether the pose may be used, and what speaks most against it."""
        if self.doubt <= 0.0:
            return Stop.CONVERGED
        parts, *others = self.doubts
        return Stop.DISAGREEMENT if parts >= max(others) else Stop.AMBIGUOUS

    @property
    def sentence(self) -> str:
        """Why the pose is refused, and what the user can do."""
        if self.stop is Stop.DISAGREEMENT:
            return (
                f"parts of the ultrasound, registered on their own, disagree by {self.parts_mm:.1f} mm; give "
                "a larger sweep or another MR contrast too, and check that both images are of this patient"
            )
        return (
            f"{100 * self.agreeing_starts:.0f} % of the starts end at this pose, and another explains "
            f"{100 * self.next_best_share:.0f} % as much; the similarity stands {self.z_score:.1f} standard "
            f"deviations above wrong poses, usual are {USUAL_Z:g} or more; give a nearer start (--start) or "
            "another MR contrast as well, and check that both images are of this patient"
        )
