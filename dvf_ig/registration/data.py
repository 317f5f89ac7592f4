"""What is registered to what, and how: slices and model at two resolutions, boundary, landmarks, options."""

from dataclasses import dataclass

from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.registration.boundary.fit import Boundary
from dvf_ig.registration.evidence.checks import IMAGE_LIMITS, Limits
from dvf_ig.registration.evidence.covariance import PlacementUncertainty
from dvf_ig.registration.lc2.channels import ModelChannels
from dvf_ig.registration.lc2.lc2 import Lc2, SliceThreads
from dvf_ig.registration.lc2.slices import SliceSet

from .start import LandmarkPrior


@dataclass(frozen=True, slots=True)
class RegistrationOptions:
    """Defaults come from tuning seeds 101–106 of the synthetic world; reported seeds were not used.

    Attributes:
        starts: displaced copies of the start pose, besides the start itself.
        spread_mm: how far a displaced copy is from the start at the heart's radius.
        patch_mm: edge of an LC2 patch.
        density_width_mm: width over which patches share weight, see `density_weights`; None: they do not.
        times_seen: how many slices show the same place: 3 of a volume cut along three axes.
        bound_mm: how far a pose may move from the start over the heart.
        candidates: most poses that are refined on fine slices.
        min_overlap: least share of the slices inside the model's volume.
        limits: what the evidence may be.
        kind: of images, by which the evidence was calibrated ("sweep", "volumes"); None: no probability is
            stated.
    """

    starts: int = 12
    spread_mm: float = 9.0
    patch_mm: float = 13.0
    density_width_mm: float | None = None
    times_seen: int = 1
    bound_mm: float = 30.0
    candidates: int = 3
    min_overlap: float = 0.35
    limits: Limits = IMAGE_LIMITS
    kind: str | None = None


@dataclass(frozen=True, slots=True)
class Level:
    """One resolution of the same data."""

    slices: SliceSet
    model: ModelChannels
    pitch_mm: float

    def metric(self, options: RegistrationOptions, threads: SliceThreads) -> Lc2:
        """LC2 at this resolution."""
        return Lc2(
            self.slices,
            self.model,
            patch_mm=options.patch_mm,
            pitch_mm=self.pitch_mm,
            density_width_mm=options.density_width_mm,
            threads=threads,
        )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RegistrationData:
    """What is registered to what: the source frame is that of the slices, the target frame that of the model.

    Attributes:
        coarse, fine: the same slices and model at two resolutions.
        center_mm: (3,) centre of the heart box in the target frame, about which poses turn.
        boundary: boundary points in the slices, none where they show none, and the model's surface, where
            that is known.
        prior: touched landmarks that the pose must also agree with, weighted by their spread.
        placement: what calibrations and clocks leave open of where the slices lie; None where they are one
            image, which needs neither.
        rr_s: usual length of the beats in which the slices were taken; None for an organ that does not beat.
    """

    coarse: Level
    fine: Level
    center_mm: FloatArray
    boundary: Boundary | None = None
    prior: LandmarkPrior | None = None
    rr_s: float | None = None
    placement: PlacementUncertainty | None = None

    @property
    def visible_boundary(self) -> Boundary | None:
        """The boundary where the slices show one."""
        return self.boundary if self.boundary is not None and len(self.boundary.points) else None
