"""Input of a registration: slices of ultrasound, the heart they are compared with, and options by kind."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from dvf_ig.core import DvfModel, FloatArray, Rigid, TrackedVolume, read_only_arrays
from dvf_ig.core.progress import thread_pool
from dvf_ig.kernels.compiled import thread_count
from dvf_ig.registration.boundary.fit import Boundary
from dvf_ig.registration.boundary.points import BoundaryPoints, boundary_points
from dvf_ig.registration.boundary.target import BoundaryTarget
from dvf_ig.registration.evidence.checks import IMAGE_LIMITS, SLICE_LIMITS, VOLUME_LIMITS, Limits
from dvf_ig.registration.evidence.covariance import PlacementUncertainty
from dvf_ig.registration.evidence.image_offset import ProbePoses
from dvf_ig.registration.lc2.channels import ModelChannels
from dvf_ig.registration.lc2.lc2 import Lc2, SliceThreads
from dvf_ig.registration.lc2.slices import SliceSet, prepare_volumes, within

from .coverage import CoveredPart
from .start import LandmarkPrior

VOLUME_SMOOTHING_MM = 3.0
"""Standard deviation of the Gaussian on the model's channels that gated volumes are compared with. Tuning
seeds 101–106, two views, three phases: median TRE 0.74 mm; 0.83 with 2.5 or 3.5 mm, and 0.83 on 2 mm
voxels."""
COARSE_PITCH_MM, COARSE_PLANES = 4.0, 6
"""Pixels of the coarse planes of volumes, and about how many planes along each axis."""
FINE_PITCH_MM, FINE_PLANES = 3.0, 13
"""Pixels and number of the fine planes of volumes."""
BOUNDARY_PITCH_MM, BOUNDARY_PLANES = 2.0, 8
"""Pixels and number of the planes of volumes on which the boundary is found."""
DENSITY_WIDTH_MM = 12.0
"""Patches share their weight over this width: a sweep sees the heart's middle from everywhere. On tuning
seeds 101–104 it takes the TRE from 1.02 to 0.93 mm, the force error from 0.081 to 0.079 N; 20 mm do alike."""


@dataclass(frozen=True, slots=True)
class RegistrationOptions:
    """How images of one kind are searched and judged.

    Defaults come from tuning seeds 101–106 of the synthetic world; reported seeds were not used.

    Attributes:
        starts: displaced copies of the start pose, in addition to the start itself.
        spread_mm: how far a displaced copy is from the start at the heart's radius.
        patch_mm: edge of an LC2 patch.
        density_width_mm: width over which patches share weight, see `lc2.patches`; None for equal weights.
        times_seen: how many slices show the same position: 3 of a volume cut along three axes.
        bound_mm: how far a pose may move from the start over the heart.
        candidates: most poses that are refined on fine slices.
        min_overlap: least share of the slices inside the model's volume; of a heart that is covered in part,
            least share of that part that the slices image.
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


SWEEP = RegistrationOptions(density_width_mm=DENSITY_WIDTH_MM, limits=SLICE_LIMITS, kind="sweep")
"""Search and limits for tracked frames against grey levels of MR."""
VOLUMES = RegistrationOptions(
    starts=8, spread_mm=12.0, candidates=2, times_seen=3, bound_mm=120.0, limits=VOLUME_LIMITS, kind="volumes"
)
"""Search and limits for gated volumes against smoothed grey levels of MR."""


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """The slices at one resolution."""

    slices: SliceSet
    pitch_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class UltrasoundImages:
    """Ultrasound of one heart whose slices share one unknown pose.

    Attributes:
        coarse, fine: the same slices at two resolutions.
        boundary: boundary points of blood and wall in the slices; None if they are not to be used.
        rr_s: usual length of the beats in which the slices were taken; None for an organ that does not beat.
        placement: uncertainty of calibrations and clocks; None for slices of one image, which needs neither.
        options: how images of this kind are searched and judged.
        seconds: computing time of their preparation.
        probe: where the probe was, to check its calibration; None if there is none, or it was checked before.
    """

    coarse: Level
    fine: Level
    boundary: BoundaryPoints | None = None
    rr_s: float | None = None
    placement: PlacementUncertainty | None = None
    options: RegistrationOptions = RegistrationOptions()
    seconds: float = 0.0
    probe: ProbePoses | None = None


class HeartTarget(Protocol):
    """A heart that ultrasound is registered to, in the model's frame: `session.Heart` is one."""

    @property
    def channels(self) -> ModelChannels:
        """Channels by which LC2 explains the ultrasound."""

    @property
    def center_mm(self) -> FloatArray:
        """(3,) centre of the heart box, about which poses turn."""

    @property
    def surface(self) -> BoundaryTarget | None:
        """The boundary of blood and wall at the phases in use; None if it is not known."""

    @property
    def covered(self) -> CoveredPart | None:
        """The part of the heart that its images cover; None if they hold all of it."""

    @property
    def model(self) -> DvfModel | None:
        """The guarded surface, from which the depth of walls is measured; None if it is not known."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class HeartChannels:
    """A plain `HeartTarget`."""

    channels: ModelChannels
    center_mm: FloatArray
    surface: BoundaryTarget | None = None
    covered: CoveredPart | None = None
    model: DvfModel | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Images, heart and landmarks together, as the steps of a registration use them."""

    images: UltrasoundImages
    heart: HeartTarget
    prior: LandmarkPrior | None
    threads: SliceThreads

    @property
    def options(self) -> RegistrationOptions:
        return self.images.options

    @property
    def center_mm(self) -> FloatArray:
        return self.heart.center_mm

    @property
    def boundary(self) -> Boundary | None:
        """The boundary in the slices with the model's; None if either is not known."""
        if self.images.boundary is None or self.heart.surface is None:
            return None
        return Boundary(self.images.boundary, self.heart.surface)

    @property
    def visible_boundary(self) -> Boundary | None:
        """The boundary, if the slices show any of it."""
        return self.boundary if self.boundary is not None and len(self.boundary.points) else None

    def boundary_at(self, pose: Rigid) -> Boundary | None:
        """The visible boundary without what lies outside the covered part of the heart at a pose."""
        seen, covered = self.visible_boundary, self.heart.covered
        if seen is None or covered is None:
            return seen
        points = seen.points.subset(covered.holds(pose.apply_array(seen.points.points_mm)))
        return replace(seen, points=points) if len(points) else None

    def compared(self, level: Level, pose: Rigid) -> SliceSet:
        """The slices without what lies outside the covered part of the heart at a pose."""
        covered = self.heart.covered
        return level.slices if covered is None else covered.compared(level.slices, pose)

    def inside_model(self, level: Level, pose: Rigid) -> SliceSet:
        """The slices without what lies outside the model's volume, or the covered part, at a pose."""
        if self.heart.covered is None:
            return within(level.slices, self.heart.channels.grid, pose)
        return self.compared(level, pose)

    def coarse_lc2(self, slices: SliceSet | None = None) -> Lc2:
        """LC2 of the coarse slices, or of some of them."""
        return self._lc2(self.images.coarse, slices)

    def fine_lc2(self, slices: SliceSet | None = None) -> Lc2:
        """LC2 of the fine slices, or of some of them."""
        return self._lc2(self.images.fine, slices)

    def _lc2(self, level: Level, slices: SliceSet | None) -> Lc2:
        return Lc2(
            level.slices if slices is None else slices,
            self.heart.channels,
            patch_mm=self.options.patch_mm,
            pitch_mm=level.pitch_mm,
            density_width_mm=self.options.density_width_mm,
            threads=self.threads,
        )


def images_of_volumes(
    volumes: Sequence[TrackedVolume], *, grey: bool, clock: Callable[[], float]
) -> UltrasoundImages:
    """Cut gated 3-D images into planes along their axes, each with its position and phase.

    Args:
        volumes: any number of views and phases.
        grey: they are compared with grey levels of MR, smoothed by VOLUME_SMOOTHING_MM; otherwise no
            probability is stated.
        clock: seconds from any origin, for `seconds`.
    Raises:
        InvalidInputError: no volume, or nothing insonified.
    """
    began = clock()
    with thread_pool(thread_count()) as pool:
        boundary = pool.submit(_boundary, volumes)
        coarse, fine = pool.map(
            lambda sizes: Level(prepare_volumes(volumes, pitch_mm=sizes[0], planes=sizes[1]), sizes[0]),
            ((COARSE_PITCH_MM, COARSE_PLANES), (FINE_PITCH_MM, FINE_PLANES)),
        )
        points = boundary.result()
    options = VOLUMES if grey else replace(VOLUMES, kind=None)
    return UltrasoundImages(coarse, fine, points, options=options, seconds=clock() - began)


def _boundary(volumes: Sequence[TrackedVolume]) -> BoundaryPoints:
    return boundary_points(prepare_volumes(volumes, pitch_mm=BOUNDARY_PITCH_MM, planes=BOUNDARY_PLANES))
