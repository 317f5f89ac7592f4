"""Non-rigid registration of two phases: Gauss–Newton for the free-form deformation between them."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import ndimage

from dvf_ig.core import AnyArray, BoolArray, FloatArray, IntArray, InvalidInputError, read_only_arrays
from dvf_ig.preop.conjugate_gradients import conjugate_gradients

from .free_form import Bending, FreeForm, Lattice, volume_ratio
from .slice_stack import observable_axes

MIN_VOXELS = 100
MIN_VOLUME_RATIO = 0.02
"""Smallest accepted share of its volume to which a voxel is compressed; below, the search is repeated."""
STIFFER_ATTEMPTS, STIFFER_FACTOR = 4, 3.0
INNER_TOLERANCE = 1e-2
"""Share of the first residual that ends the conjugate gradients within a Gauss–Newton step."""


@dataclass(frozen=True, slots=True)
class FreeFormOptions:
    """Options of the free-form fit; grey levels are in units of the image's own standard deviation.

    Attributes:
        pitch_mm: knot pitch.
        stiffness_mm2: weight of the bending energy against the squared residual, both integrated over mm³.
        blurs_mm: standard deviation of the Gaussian on both images, coarse to fine.
        steps: largest number of Gauss–Newton steps at each blur.
        inner_steps: largest number of conjugate-gradient steps in each.
        tolerance: a level ends when a step lowers the cost by less than this share.
    """

    pitch_mm: float = 6.0
    stiffness_mm2: float = 1.0
    blurs_mm: tuple[float, ...] = (1.0,)
    steps: int = 6
    inner_steps: int = 15
    tolerance: float = 2e-3

    def __post_init__(self) -> None:
        if not 4.0 <= self.pitch_mm <= 40.0:
            raise InvalidInputError(f"knot pitch of the motion is {self.pitch_mm:g} mm; needed 4 to 40 mm")
        if not self.stiffness_mm2 > 0.0:
            raise InvalidInputError(f"stiffness is {self.stiffness_mm2:g} mm²; it must be positive")
        if not self.blurs_mm or min(self.blurs_mm) < 0.0 or min(self.steps, self.inner_steps) < 1:
            raise InvalidInputError(
                "blurs or steps are missing; needed at least one blur of 0 mm or more and one step"
            )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """Both images at one level of the coarse-to-fine pyramid, on the voxels that are compared.

    Attributes:
        lattice: control points, evaluated on every few voxels.
        axes: the k axes along which motion is estimated.
        where: index arrays of the n voxels compared, in the lattice's grid.
        index: (3, n) their positions, in voxels of the moving image.
        fixed: (n,) grey levels, mean 0 and standard deviation 1.
        moving, gradient: grey levels of the moving image and their derivative per mm along each of these.
        spacing_mm: (3,) voxel pitch of the moving image.
        voxel_mm3: volume represented by each of the voxels.
    """

    lattice: Lattice
    axes: IntArray
    where: tuple[AnyArray, ...]
    index: FloatArray
    fixed: FloatArray
    moving: FloatArray
    gradient: tuple[FloatArray, ...]
    spacing_mm: FloatArray
    voxel_mm3: float


def match_images(
    fixed: AnyArray,
    moving: AnyArray,
    mask: BoolArray,
    start: FreeForm,
    options: FreeFormOptions = FreeFormOptions(),
    *,
    observable: BoolArray | None = None,
) -> FreeForm:
    """Find the deformation x ↦ x + u(x) that makes moving(x + u(x)) similar to fixed(x).

    Minimises the mean squared residual left by the best gain and offset (which is one minus the squared
    correlation) plus the bending energy. If the result compresses a voxel to almost nothing, the search is
    repeated from the start, three times as stiff, up to four times; the caller judges any remaining folding.

    Args:
        fixed, moving: (nx, ny, nz) grey levels on the grid of the start's lattice.
        mask: (nx, ny, nz) voxels of the fixed image that are compared.
        start: initial deformation; close enough for the finest structure to overlap at the coarsest blur.
        observable: (3,) axes along which motion is estimated; None decides by the voxel size.
    Raises:
        InvalidInputError: fewer than 100 voxels to compare, or images without any contrast there.
    Source: Rueckert 1999 (free-form deformation), solved by Gauss–Newton with conjugate gradients.
    """
    if observable is None:
        observable = observable_axes(start.grid.spacing_mm)
    bending = _bending(start.lattice, tuple(np.where(observable, 0.0, options.pitch_mm).tolist()))
    levels = [_level(fixed, moving, mask, start.lattice, observable, blur_mm) for blur_mm in options.blurs_mm]
    axes = levels[0].axes
    for attempt in range(STIFFER_ATTEMPTS + 1):
        stiffer = replace(options, stiffness_mm2=options.stiffness_mm2 * STIFFER_FACTOR**attempt)
        coefficients = start.coefficients[..., axes]
        for level in levels:
            coefficients = _minimise(level, bending, coefficients, stiffer)
        everywhere = start.coefficients.copy()
        everywhere[..., axes] = coefficients
        fitted = FreeForm(start.lattice, everywhere)
        if volume_ratio(fitted.on_voxels(), fitted.grid.spacing_mm, mask).min() > MIN_VOLUME_RATIO:
            break
    return fitted


@lru_cache(maxsize=4)
def _bending(lattice: Lattice, least_pitch_mm: tuple[float, ...]) -> Bending:
    """Build the energy on a lattice, which all phases of a cycle share."""
    return Bending.of(lattice, np.array(least_pitch_mm))


def blurred(
    values: AnyArray, spacing_mm: FloatArray, blur_mm: float, observable: BoolArray | None = None
) -> FloatArray:
    """Blur grey levels by a Gaussian, except along an axis whose voxels are wider than the blur."""
    wide = spacing_mm > 3.0 * blur_mm
    sigma = np.where(wide if observable is None else wide | ~observable, 0.0, blur_mm / spacing_mm)
    return np.asarray(ndimage.gaussian_filter(values.astype(np.float64), sigma, mode="nearest"))


def _level(
    fixed: AnyArray, moving: AnyArray, mask: BoolArray, whole: Lattice, observable: BoolArray, blur_mm: float
) -> _Level:
    spacing = whole.grid.spacing_mm
    step = np.where(observable, np.rint(blur_mm / spacing), 1.0)
    sx, sy, sz = np.maximum(step, 1).astype(int).tolist()
    where = np.nonzero(mask[::sx, ::sy, ::sz])
    if len(where[0]) < MIN_VOXELS:
        raise InvalidInputError(
            f"{len(where[0])} voxels to compare at a blur of {blur_mm:g} mm; needed at least {MIN_VOXELS}: "
            "check that the labelled organ is inside the image"
        )
    grey = blurred(fixed, spacing, blur_mm, observable)[::sx, ::sy, ::sz][where]
    other = blurred(moving, spacing, blur_mm, observable)
    if not grey.std() > 0.0 or not other.std() > 0.0:
        raise InvalidInputError(
            "an image has no contrast around the organ; check that it is the right 4-D image"
        )
    lattice = whole.thinned((sx, sy, sz))
    axes = np.flatnonzero(observable & (np.array(other.shape) > 1))
    return _Level(
        lattice,
        axes,
        where,
        np.stack(where).astype(np.float64) * np.array([[sx], [sy], [sz]]),
        (grey - grey.mean()) / grey.std(),
        other,
        tuple(np.gradient(other, float(spacing[axis]), axis=axis) for axis in axes),
        spacing,
        float(np.prod(lattice.grid.spacing_mm)),
    )


def _minimise(level: _Level, bending: Bending, start: FloatArray, options: FreeFormOptions) -> FloatArray:
    """Minimise the cost by Gauss–Newton steps from `start`; return the coefficients of the lowest."""
    best, lowest = start, np.inf
    trial = start
    for _ in range(options.steps):
        residual, slope = _residual(level, trial)
        bend = options.stiffness_mm2 * bending.half_gradient(trial)
        cost = float(level.voxel_mm3 * (residual * residual).sum() + (trial * bend).sum())
        if cost >= lowest:
            break
        converged = cost > lowest * (1.0 - options.tolerance)
        best, lowest = trial, cost
        if converged:
            break
        trial = trial + _step(level, bending, residual, slope, bend, options)
    return best


def _residual(level: _Level, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the (n,) residual after the best gain and offset, and (n, k) its change per mm moved."""
    moved_mm = level.lattice.on_voxels(coefficients)[level.where]
    at = level.index.copy()
    at[level.axes] += (moved_mm / level.spacing_mm[level.axes]).T
    grey = ndimage.map_coordinates(level.moving, at, order=1, mode="nearest")
    slope = np.stack(
        [ndimage.map_coordinates(s, at, order=1, mode="nearest") for s in level.gradient], axis=1
    )
    centered = grey - grey.mean()
    power = float((centered * centered).sum())
    gain = float((centered * level.fixed).sum()) / power if power > 0.0 else 0.0
    return gain * centered - level.fixed, gain * slope


def _step(
    level: _Level,
    bending: Bending,
    residual: FloatArray,
    slope: FloatArray,
    bend: FloatArray,
    options: FreeFormOptions,
) -> FloatArray:
    """Solve for the Gauss–Newton step δ: (JᵀJ + λH) δ = −Jᵀr − λHc, J = slope · B; `bend` is λHc."""
    everywhere = np.zeros((*level.lattice.grid.shape, len(level.axes)))
    everywhere[level.where] = slope
    weighted = level.voxel_mm3 * everywhere

    def normal(step: FloatArray) -> FloatArray:
        along = np.einsum("xyzd,xyzd->xyz", everywhere, level.lattice.on_voxels(step))
        data = level.lattice.adjoint(weighted * along[..., None])
        data += options.stiffness_mm2 * bending.half_gradient(step)
        return data

    rest = np.zeros(level.lattice.grid.shape)
    rest[level.where] = residual
    right = -level.lattice.adjoint(weighted * rest[..., None]) - bend
    diagonal = level.lattice.adjoint_of_squares(weighted * everywhere)
    diagonal = diagonal + options.stiffness_mm2 * bending.diagonal(level.lattice)
    solution = conjugate_gradients(
        normal,
        right,
        lambda left: np.asarray(left / diagonal),
        tolerance=INNER_TOLERANCE,
        max_iterations=options.inner_steps,
    )
    return solution.x
