"""Motion over the cycle from grey levels: end-diastole registered to every phase (Ren 2008, Section III).

Two chains of registrations start at end-diastole, one forwards and one backwards in time, and meet half a
cycle later. Every phase is registered to end-diastole itself, so errors do not accumulate; its neighbour only
gives the initial deformation. Both chains register the phase at which they meet; how far they differ there is
the closure error of the cycle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import Literal, Protocol

import numpy as np
from scipy import ndimage

from dvf_ig.core import (
    AnyArray,
    BoolArray,
    FloatArray,
    Grid,
    InvalidInputError,
    Mesh,
    Progress,
    SurfaceSeries,
    Volume,
    VolumeSeries,
    read_only_arrays,
    untold,
)
from dvf_ig.core.progress import thread_pool
from dvf_ig.core.space.frames import require_same_frame

from .consistency import LIMIT_MM, Stiffened, inverse_index, made_consistent
from .demons import DemonsOptions, DisplacementField, match_images_by_demons
from .free_form import FreeForm, Lattice, volume_ratio
from .image_match import FreeFormOptions, match_images
from .outliers import AnyDeformation, ReplacedPhase, replace_outliers
from .region import Compared, compared_region, cropped_grid

Method = Literal["bspline", "demons"]


class Deformation(Protocol):
    """Deformation x ↦ x + u(x) from end-diastole to one phase."""

    @property
    def grid(self) -> Grid: ...
    def on_voxels(self) -> FloatArray: ...
    def move(self, xyz_mm: FloatArray) -> FloatArray: ...


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """Options of the motion estimate.

    Attributes:
        method: "bspline" (free-form, Gauss–Newton) or "demons" (diffeomorphic, SimpleITK).
        rim_mm: width of the rim around the organ in which grey levels are compared.
        free_form, demons: settings of each method.
        threads: one for each chain, at most two; has no influence on the result.
    """

    method: Method = "bspline"
    rim_mm: float = 10.0
    free_form: FreeFormOptions = field(default_factory=FreeFormOptions)
    demons: DemonsOptions = field(default_factory=DemonsOptions)
    threads: int = 2

    def __post_init__(self) -> None:
        if self.method not in ("bspline", "demons"):
            raise InvalidInputError(f"motion method is '{self.method}'; needed bspline or demons")
        if not 2.0 <= self.rim_mm <= 50.0:
            raise InvalidInputError(f"rim around the organ is {self.rim_mm:g} mm; needed 2 to 50 mm")
        if self.threads < 1:
            raise InvalidInputError(f"{self.threads} threads requested; needed at least 1")


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CycleMotion:
    """Estimated motion: the position of every point of end-diastole in each phase.

    Attributes:
        ed_phase: the reference phase, end-diastole.
        deformations: one a phase, all on one grid around the organ; the identity at end-diastole.
        meeting_phase: the phase at which the two chains meet.
        meeting: the backward chain's deformation there; the forward chain's is in `deformations`.
        start: voxel of the 4-D image at which that grid begins.
        mask: voxels of that grid that were compared.
        observable: (3,) axes of the grid along which motion was estimated; not across a stack of slices.
        spacing_lost: slices differ as if they lay much further apart than the header says.
        replaced: phases with a rejected motion of their own, interpolated in time instead.
        stiffened: phases whose own motion did not return when registered back and was estimated stiffer.
    """

    ed_phase: int
    deformations: tuple[Deformation, ...]
    meeting_phase: int
    meeting: Deformation
    start: tuple[int, int, int]
    mask: BoolArray
    observable: BoolArray
    spacing_lost: bool = False
    replaced: tuple[ReplacedPhase, ...] = ()
    stiffened: tuple[Stiffened, ...] = ()

    @property
    def grid(self) -> Grid:
        return self.meeting.grid

    def cropped(self, values: AnyArray) -> AnyArray:
        """Crop (nx, ny, nz) values on the 4-D image's grid to this motion's grid."""
        return values[tuple(slice(a, a + n) for a, n in zip(self.start, self.grid.shape, strict=True))]


def track_cycle(
    image: VolumeSeries,
    organ: BoolArray,
    *,
    ed_phase: int = 0,
    blood: BoolArray | None = None,
    options: MotionOptions = MotionOptions(),
    progress: Progress | None = None,
) -> CycleMotion:
    """Register end-diastole to every phase of a cyclic 4-D image.

    Args:
        image: grey levels.
        organ: (nx, ny, nz) voxels of the organ at end-diastole.
        ed_phase: the phase in which the organ was labelled.
        blood: voxels of it that are labelled as blood, if known. The rim is narrower along blood that borders
            on unlabelled tissue (the right ventricle, whose wall is thin): what lies beyond slides along it.
        progress: called with the fraction done.
    Raises:
        InvalidInputError: an organ of another shape or without voxels, or no such phase.
    """
    phases = len(image.timing)
    if organ.shape != image.grid.shape:
        raise InvalidInputError(f"the organ's mask is {organ.shape}, the image {image.grid.shape}")
    if not 0 <= ed_phase < phases:
        raise InvalidInputError(f"end-diastole is phase {ed_phase}; the image has phases 0 to {phases - 1}")
    if not organ.any():
        raise InvalidInputError("the organ has no voxels at end-diastole; check the label values")
    box, compared, lost = compared_region(image, organ, blood, ed_phase, options.rim_mm)
    counter = _Counter(phases, progress)
    identity = _identity(cropped_grid(image.grid, box), compared.observable, options)

    def chain(order: Sequence[int]) -> list[tuple[AnyDeformation, float]]:
        chained = [(identity, 0.0)]
        for phase in order:
            chained.append(_matched(compared, phase, chained[-1][0], options))
            counter.step()
        return chained[1:]

    half = phases // 2
    forwards = [(ed_phase + k) % phases for k in range(1, half + 1)]
    backwards = [(ed_phase - k) % phases for k in range(1, phases - half + 1)]
    with thread_pool(min(options.threads, 2)) as pool:
        ahead, behind = pool.map(chain, (forwards, backwards))
    by_phase = {**dict(zip(backwards, behind, strict=True)), **dict(zip(forwards, ahead, strict=True))}
    by_phase[ed_phase] = (identity, 0.0)
    estimates = [by_phase[i][0] for i in range(phases)]
    ordered, replaced = replace_outliers(estimates, compared.grey, compared.mask, ed_phase)
    rejected = {r.phase for r in replaced}
    stiffened = tuple(
        Stiffened(i, by_phase[i][1]) for i in range(phases) if by_phase[i][1] > LIMIT_MM and i not in rejected
    )
    return CycleMotion(
        ed_phase,
        ordered,
        forwards[-1],
        behind[-1][0],
        (int(box[0].start), int(box[1].start), int(box[2].start)),
        compared.mask,
        compared.observable,
        lost,
        replaced,
        stiffened,
    )


def propagate_surface(
    motion: CycleMotion, image: VolumeSeries, surface: Mesh, name: str, patient: str
) -> SurfaceSeries:
    """Propagate the end-diastolic surface to every phase; vertex i is one material point in all of them.

    Raises:
        FrameMismatchError: the surface is in another frame than the image.
    """
    require_same_frame(image.grid.frame, surface.frame, f"surface {name}")
    moved = [
        surface.vertices_mm if i == motion.ed_phase else deformation.move(surface.vertices_mm)
        for i, deformation in enumerate(motion.deformations)
    ]
    return SurfaceSeries(name, surface.frame, np.stack(moved), surface.triangles, image.timing, patient)


def propagate_labels(motion: CycleMotion, image: VolumeSeries, labels: Volume, phase: int) -> AnyArray:
    """Propagate (nx, ny, nz) end-diastolic labels to a phase, background beyond the motion's grid.

    Each voxel takes the label at its end-diastolic position: the inverse deformation, by fixed-point
    iteration. If the image ends within the organ, what enters from beyond its border takes the label at the
    border, as if the organ continued there unchanged.
    """
    out = np.zeros(image.grid.shape, dtype=labels.values.dtype)
    values = motion.cropped(labels.values)
    if phase != motion.ed_phase:
        deformation = motion.deformations[phase]
        origin = inverse_index(np.moveaxis(deformation.on_voxels() / deformation.grid.spacing_mm, -1, 0))
        values = ndimage.map_coordinates(values, origin, order=0, mode="nearest")
    motion.cropped(out)[...] = values
    return out


def _matched(
    compared: Compared, phase: int, before: AnyDeformation, options: MotionOptions
) -> tuple[AnyDeformation, float]:
    """Match end-diastole to a phase from its neighbour's deformation; also the error of the way back, mm."""
    pair = (compared.grey[compared.ed_phase], compared.grey[phase])
    mask, observable = compared.mask, compared.observable
    if not isinstance(before, FreeForm):
        by_demons = match_images_by_demons(*pair, mask, before, options.demons, observable=observable)
        return by_demons, 0.0
    matched = match_images(*pair, mask, before, options.free_form, observable=observable)
    return made_consistent(matched, pair, mask, compared.parts, observable, options.free_form)


def _identity(grid: Grid, observable: BoolArray, options: MotionOptions) -> AnyDeformation:
    """Build the identity deformation, with one knot for each slice across a stack."""
    if options.method == "demons":
        return DisplacementField.identity(grid)
    pitch_mm = np.where(observable, options.free_form.pitch_mm, grid.spacing_mm)
    return FreeForm.identity(Lattice.over(grid, pitch_mm))


class _Counter:
    """Counter of finished registrations of both threads."""

    def __init__(self, total: int, report: Progress | None) -> None:
        self._total, self._done = total, 0
        self._report, self._lock = report or untold, Lock()

    def step(self) -> None:
        with self._lock:
            self._done += 1
            self._report(self._done / self._total)


def cavity_volumes_mm3(motion: CycleMotion, cavity: BoolArray) -> FloatArray:
    """Compute (n,) volumes of the cavity by phase: ∫ det(∂x/∂X) dV over its voxels at end-diastole.

    Args:
        cavity: (nx, ny, nz) voxels of the cavity at end-diastole, on the 4-D image's grid.
    Raises:
        InvalidInputError: a cavity without voxels.
    """
    inside = np.asarray(motion.cropped(cavity))
    if not inside.any():
        raise InvalidInputError("the cavity has no voxels at end-diastole; check the label values")
    voxel_mm3 = float(np.prod(motion.grid.spacing_mm))
    spacing = motion.grid.spacing_mm
    ratios = [volume_ratio(d.on_voxels(), spacing, inside) for d in motion.deformations]
    return np.array([voxel_mm3 * float(ratio.sum()) for ratio in ratios])
