"""Carry one image onto another: Gauss–Newton for the free-form deformation between two phases."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from dvf_ig.core import AnyArray, BoolArray, FloatArray, InvalidInputError, read_only_arrays

from .free_form import Bending, FreeForm, Lattice, volume_ratio

FEWEST_VOXELS = 100
LEAST_VOLUME_RATIO = 0.02
STIFFENINGS, STIFFENING = 4, 3.0

SLICE_RATIO = 2.0
"""Voxels this much longer than wide are slices: what lies between them is unknown, and its motion too."""


@dataclass(frozen=True, slots=True)
class FreeFormOptions:
    """How a free-form deformation is fitted; grey levels count in units of the image's own spread.

    Attributes:
        pitch_mm: knot pitch.
        stiffness_mm2: weight of the bending energy against the squared residual, both integrated over mm³.
        blurs_mm: standard deviation of the Gaussian on both images, coarse to fine.
        steps: most Gauss–Newton steps at each blur.
        inner_steps: most conjugate-gradient steps in each.
        tolerance: a level ends where a step lowers the cost by less than this share.
    """

    pitch_mm: float = 10.0
    stiffness_mm2: float = 3.0
    blurs_mm: tuple[float, ...] = (3.0, 1.0)
    steps: int = 6
    inner_steps: int = 15
    tolerance: float = 2e-3

    def __post_init__(self) -> None:
        if not 4.0 <= self.pitch_mm <= 40.0:
            raise InvalidInputError(f"knot pitch of the motion is {self.pitch_mm:g} mm; needed 4 to 40 mm")
        if not self.stiffness_mm2 > 0.0:
            raise InvalidInputError(f"stiffness is {self.stiffness_mm2:g} mm²; it must be positive")
        if not self.blurs_mm or min(self.blurs_mm) < 0.0 or min(self.steps, self.inner_steps) < 1:
            raise InvalidInputError("needed at least one blur of 0 mm or more, and at least one step")


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """Both images at one blur, on the voxels that count.

    Attributes:
        lattice: control points, on every few voxels.
        where: index arrays of the n voxels that count, in the lattice's grid.
        index: (3, n) where they lie, in voxels of the moving image.
        fixed: (n,) grey levels, mean 0 and spread 1.
        moving, slopes: grey levels of the other image and their change per mm along each axis.
        voxel_mm3: volume that each of the voxels stands for.
    """

    lattice: Lattice
    where: tuple[AnyArray, ...]
    index: FloatArray
    fixed: FloatArray
    moving: FloatArray
    slopes: tuple[FloatArray, ...]
    spacing_mm: FloatArray
    voxel_mm3: float


def match_images(
    fixed: AnyArray,
    moving: AnyArray,
    counts: BoolArray,
    start: FreeForm,
    options: FreeFormOptions = FreeFormOptions(),
) -> FreeForm:
    """Deformation x ↦ x + u(x) for which moving(x + u(x)) looks like fixed(x).

    Minimises the mean squared residual left by the best gain and offset (which is one minus the squared
    correlation) plus the bending energy. Where the result squeezes space to nothing it is found again from
    the start, three times as stiff, up to four times; what still folds then is for the caller to judge.

    Args:
        fixed, moving: (nx, ny, nz) grey levels on the grid of the start's lattice.
        counts: (nx, ny, nz) voxels of the fixed image that are compared.
        start: where to begin; near enough that the finest structure overlaps at the coarsest blur.
    Raises:
        InvalidInputError: fewer than 100 voxels to compare, or images without any contrast there.
    Source: Rueckert 1999 (free-form deformation), solved by Gauss–Newton with conjugate gradients.
    """
    bending = Bending.of(start.lattice)
    levels = [_level(fixed, moving, counts, start.lattice, blur_mm) for blur_mm in options.blurs_mm]
    for attempt in range(STIFFENINGS + 1):
        stiffer = replace(options, stiffness_mm2=options.stiffness_mm2 * STIFFENING**attempt)
        coefficients = start.coefficients
        for level in levels:
            coefficients = _descend(level, bending, coefficients, stiffer)
        found = FreeForm(start.lattice, coefficients)
        if volume_ratio(found.on_voxels(), found.grid.spacing_mm, counts).min() > LEAST_VOLUME_RATIO:
            break
    return found


def seen_axes(spacing_mm: FloatArray) -> BoolArray:
    """(3,) False along the normal of a stack of slices: motion is sought within slices only.

    Between distant slices any displacement can be fitted to the interpolated grey levels; it folds.
    """
    return np.asarray(spacing_mm <= SLICE_RATIO * spacing_mm.min())


def blurred(values: AnyArray, spacing_mm: FloatArray, blur_mm: float) -> FloatArray:
    """Grey levels after a Gaussian; an axis whose voxels are wider than the blur is left alone."""
    sigma = np.where(spacing_mm > 3.0 * blur_mm, 0.0, blur_mm / spacing_mm)
    return np.asarray(ndimage.gaussian_filter(values.astype(np.float64), sigma, mode="nearest"))


def _level(fixed: AnyArray, moving: AnyArray, counts: BoolArray, whole: Lattice, blur_mm: float) -> _Level:
    spacing = whole.grid.spacing_mm
    sx, sy, sz = np.maximum(np.rint(blur_mm / spacing), 1).astype(int).tolist()
    where = np.nonzero(counts[::sx, ::sy, ::sz])
    if len(where[0]) < FEWEST_VOXELS:
        raise InvalidInputError(
            f"{len(where[0])} voxels to compare at a blur of {blur_mm:g} mm; needed {FEWEST_VOXELS}: "
            "is the labelled organ inside the image?"
        )
    grey = blurred(fixed, spacing, blur_mm)[::sx, ::sy, ::sz][where]
    other = blurred(moving, spacing, blur_mm)
    if not grey.std() > 0.0 or not other.std() > 0.0:
        raise InvalidInputError("an image has no contrast around the organ; is it the right 4-D image?")
    lattice = whole.thinned((sx, sy, sz))
    seen = seen_axes(spacing) & (np.array(other.shape) > 1)
    slopes = tuple(
        np.gradient(other, step, axis=axis) if seen[axis] else np.zeros_like(other)
        for axis, step in enumerate(spacing.tolist())
    )
    return _Level(
        lattice,
        where,
        np.stack(where).astype(np.float64) * np.array([[sx], [sy], [sz]]),
        (grey - grey.mean()) / grey.std(),
        other,
        slopes,
        spacing,
        float(np.prod(lattice.grid.spacing_mm)),
    )


def _descend(level: _Level, bending: Bending, start: FloatArray, options: FreeFormOptions) -> FloatArray:
    best, lowest = start, np.inf
    trial = start
    for _ in range(options.steps):
        residual, slope = _residual(level, trial)
        stiff = options.stiffness_mm2 * bending.half_gradient(trial)
        cost = float(level.voxel_mm3 * (residual * residual).sum() + (trial * stiff).sum())
        if cost >= lowest:
            break
        settled = cost > lowest * (1.0 - options.tolerance)
        best, lowest = trial, cost
        if settled:
            break
        trial = trial + _step(level, bending, residual, slope, stiff, options)
    return best


def _residual(level: _Level, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) residual after the best gain and offset, and (n, 3) its change per mm of displacement."""
    moved_mm = level.lattice.on_voxels(coefficients)[level.where]
    at = level.index + (moved_mm / level.spacing_mm).T
    grey = ndimage.map_coordinates(level.moving, at, order=1, mode="nearest")
    slope = np.stack([ndimage.map_coordinates(s, at, order=1, mode="nearest") for s in level.slopes], axis=1)
    centered = grey - grey.mean()
    power = float((centered * centered).sum())
    gain = float((centered * level.fixed).sum()) / power if power > 0.0 else 0.0
    return gain * centered - level.fixed, gain * slope


def _step(
    level: _Level,
    bending: Bending,
    residual: FloatArray,
    slope: FloatArray,
    stiff: FloatArray,
    options: FreeFormOptions,
) -> FloatArray:
    """Solve (JᵀJ + λH) δ = −Jᵀr − λHc, J = slope · B."""
    spread = np.zeros((*level.lattice.grid.shape, 3))

    def gathered(weights: FloatArray) -> FloatArray:
        spread[level.where] = level.voxel_mm3 * weights
        return spread

    def normal(step: FloatArray) -> FloatArray:
        along = (slope * level.lattice.on_voxels(step)[level.where]).sum(axis=1)
        data = level.lattice.adjoint(gathered(slope * along[:, None]))
        return data + options.stiffness_mm2 * bending.half_gradient(step)

    right = -level.lattice.adjoint(gathered(slope * residual[:, None])) - stiff
    diagonal = level.lattice.adjoint_of_squares(gathered(slope * slope))
    diagonal = diagonal + options.stiffness_mm2 * bending.diagonal()
    return conjugate_gradient(normal, right, diagonal, options.inner_steps)


def conjugate_gradient(
    normal: Callable[[FloatArray], FloatArray],
    right: FloatArray,
    diagonal: FloatArray,
    steps: int,
    *,
    tolerance: float = 1e-2,
) -> FloatArray:
    """Solve Ax = b, Jacobi-preconditioned; sums in numpy's own order, which a threaded BLAS would not keep.

    Args:
        normal: x ↦ Ax, symmetric and positive definite.
        right, diagonal: b, and the diagonal of A.
        steps: most iterations.
        tolerance: share of the first residual, in the preconditioner's norm, that ends them.
    """
    solution, rest = np.zeros_like(right), right
    scaled = rest / diagonal
    along, power = scaled, float((rest * scaled).sum())
    enough = tolerance**2 * power
    for _ in range(steps):
        if power <= enough:
            break
        image = normal(along)
        length = power / float((along * image).sum())
        solution = solution + length * along
        rest = rest - length * image
        scaled = rest / diagonal
        last, power = power, float((rest * scaled).sum())
        along = scaled + (power / last) * along
    return solution
