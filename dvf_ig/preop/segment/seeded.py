"""Semi-automatic segmentation: from a few named seed points to labels of the heart at end-diastole.

A watershed of the grey-level gradient grows from the seeds; in a band about the organ's outline that it
found, a random walker refines the outline. The watershed alone follows single voxels of noise, the random
walker alone leaks where walls are thin and takes minutes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csr_array

from dvf_ig.core import BoolArray, FloatArray, Grid, IntArray, InvalidInputError, Seeds, Volume
from dvf_ig.core.space.frames import require_same_frame
from dvf_ig.preop.components import largest_component
from dvf_ig.preop.conjugate_gradients import conjugate_gradients
from dvf_ig.preop.motion.image_match import blurred

BACKGROUND, WALL, CAVITY = 0, 1, 2
BACKGROUND_MARKER, HEART_MARKER, CAVITY_MARKER = 1, 2, 3
MIN_WEIGHT = 1e-3
"""Smallest weight of a random walker's step, as a share of the largest."""
WALKER_TOLERANCE, WALKER_ITERATIONS = 1e-4, 400
LABEL_NAMES = ((WALL, "wall"), (CAVITY, "cavity"))


@dataclass(frozen=True, slots=True)
class SegmentOptions:
    """Options of the segmentation.

    Attributes:
        seed_radius_mm: a seed is a ball of this radius.
        beyond_mm: image kept beyond the outermost seed; everything beyond is background.
        edge_mm: standard deviation of the Gaussian in the gradient that the watershed floods.
        band_mm: half-width of the band about the watershed's outline in which the random walker decides.
        beta: how strongly an edge in grey level stops the walker (Grady 2006).
        blur_mm: standard deviation of the Gaussian on the walker's image.
        smooth_mm: standard deviation of the Gaussian that rounds the result.
    """

    seed_radius_mm: float = 2.5
    beyond_mm: float = 6.0
    edge_mm: float = 1.5
    band_mm: float = 5.0
    beta: float = 300.0
    blur_mm: float = 1.0
    smooth_mm: float = 2.0

    def __post_init__(self) -> None:
        if not (self.beta > 0.0 and self.seed_radius_mm > 0.0 and self.band_mm > 0.0):
            raise InvalidInputError("beta, the seed radius and the width of the band must be positive")
        if min(self.blur_mm, self.beyond_mm, self.smooth_mm, self.edge_mm) < 0.0:
            raise InvalidInputError("blurs, margin and smoothing cannot be negative")


def segment_from_seeds(image: Volume, seeds: Seeds, options: SegmentOptions = SegmentOptions()) -> Volume:
    """Grow labels 0 background, 1 wall, 2 cavity from seeds.

    The result is a first segmentation: inspect it, correct it by hand, and pass it on as a label image.

    Raises:
        InvalidInputError: a seed outside the image, or seeds of different names that overlap.
        FrameMismatchError: seeds in another frame than the image.
    Source: Meyer 1994 (watershed from markers), Grady 2006 (random walker).
    """
    from skimage.segmentation import watershed

    require_same_frame(image.grid.frame, seeds.heart.frame, "seeds")
    spacing = image.grid.spacing_mm
    markers = _markers(image.grid, seeds, options.seed_radius_mm)
    box = _box(markers, image.grid, options.beyond_mm)
    edge = ndimage.gaussian_gradient_magnitude(
        image.values.astype(np.float64), np.minimum(options.edge_mm / spacing, 1.0)
    )
    basins = np.asarray(watershed(edge[box], markers[box]))
    grey = blurred(image.values, spacing, options.blur_mm)[box]
    organ = _refined_outline(grey, basins, markers[box], spacing, options)
    organ = largest_component(blurred(organ, spacing, options.smooth_mm) >= 0.5)
    labels = np.zeros(image.grid.shape, dtype=np.uint8)
    labels[box] = np.where(organ & (basins == CAVITY_MARKER), CAVITY, np.where(organ, WALL, BACKGROUND))
    return Volume(image.grid, labels)


def _refined_outline(
    grey: FloatArray,
    basins: NDArray[np.int32],
    markers: NDArray[np.int32],
    spacing_mm: FloatArray,
    options: SegmentOptions,
) -> BoolArray:
    """Refine the organ: within a band about the watershed's outline the random walker decides."""
    outside = basins == BACKGROUND_MARKER
    inwards_mm, outwards_mm = (
        ndimage.distance_transform_edt(part, sampling=spacing_mm) for part in (~outside, outside)
    )
    fixed = np.where(outside, BACKGROUND_MARKER, HEART_MARKER)
    fixed[np.maximum(inwards_mm, outwards_mm) < options.band_mm] = 0
    fixed = np.where(markers > 0, np.minimum(markers, HEART_MARKER), fixed)
    if not ((fixed == 0).any() and (fixed == BACKGROUND_MARKER).any() and (fixed == HEART_MARKER).any()):
        return np.asarray(~outside)
    return random_walker_probability(grey, fixed, spacing_mm, options.beta) >= 0.5


def random_walker_probability(
    grey: FloatArray, labels: NDArray[np.int32], spacing_mm: FloatArray, beta: float
) -> FloatArray:
    """Compute (nx, ny, nz) probabilities to reach the heart before the background from a voxel.

    Steps go to the six neighbours with weights exp(−β (Δgrey/σ)²)/Δx², σ the standard deviation of the grey
    levels. The weights have a lower bound: without it a voxel behind edges on all sides is isolated and its
    probability undefined.

    Args:
        labels: BACKGROUND_MARKER, HEART_MARKER, or 0 in voxels whose probability is computed.
    Source: Grady 2006, eqs 2 and 10.
    """
    probability = (labels == HEART_MARKER).astype(np.float64)
    number = np.full(labels.shape, -1, dtype=np.int64)
    number[labels == 0] = np.arange(np.count_nonzero(labels == 0))
    count = int(number.max()) + 1
    diagonal, right = np.zeros(count), np.zeros(count)
    rows, columns, weights = [], [], []
    scale = beta / max(float(grey.var()), 1e-12)
    for axis, step_mm in enumerate(spacing_mm / spacing_mm.min()):
        low, high = ([slice(None)] * 3 for _ in range(2))
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        change = grey[tuple(high)] - grey[tuple(low)]
        weight = ((1.0 - MIN_WEIGHT) * np.exp(-scale * change**2) + MIN_WEIGHT) / step_mm**2
        for here, there in ((tuple(low), tuple(high)), (tuple(high), tuple(low))):
            unknown = number[here] >= 0
            i, j, w = number[here][unknown], number[there][unknown], weight[unknown]
            diagonal += np.bincount(i, weights=w, minlength=count)
            right += np.bincount(i, weights=w * probability[there][unknown], minlength=count)
            inner = j >= 0
            rows.append(i[inner])
            columns.append(j[inner])
            weights.append(w[inner])
    links = csr_array(
        (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=(count, count)
    )
    solution = conjugate_gradients(
        lambda x: np.asarray(diagonal * x - links @ x),
        right,
        lambda rest: np.asarray(rest / diagonal),
        tolerance=WALKER_TOLERANCE,
        max_iterations=WALKER_ITERATIONS,
    )
    probability[labels == 0] = solution.x
    return np.asarray(probability)


def _markers(grid: Grid, seeds: Seeds, radius_mm: float) -> NDArray[np.int32]:
    """Mark (nx, ny, nz) voxels: 0 unknown, 1 background, 2 heart, 3 cavity."""
    markers = np.zeros(grid.shape, dtype=np.int32)
    for value, (name, points) in enumerate(
        (("background", seeds.background), ("heart", seeds.heart), ("cavity", seeds.cavity)), start=1
    ):
        center = np.rint(grid.to_index(points.xyz_mm)).astype(np.int64)
        if len(points) and ((center < 0) | (center >= grid.shape)).any():
            raise InvalidInputError(
                f"a seed named {name} lies outside the image; give seeds in the image's LPS coordinates"
            )
        ball = _ball(grid, radius_mm)
        at = (center[:, None] + ball).reshape(-1, 3)
        at = at[((at >= 0) & (at < grid.shape)).all(axis=1)]
        present = markers[tuple(at.T)]
        if ((present > 0) & (present != value)).any():
            raise InvalidInputError(
                f"a seed named {name} lies within {2 * radius_mm:g} mm of one of another name; move one"
            )
        markers[tuple(at.T)] = value
    return markers


def _ball(grid: Grid, radius_mm: float) -> IntArray:
    """List (n, 3) voxel offsets within a radius; at least the centre."""
    reach = np.floor(radius_mm / grid.spacing_mm).astype(int)
    offsets = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach), indexing="ij"), axis=-1)
    offsets = offsets.reshape(-1, 3)
    return np.asarray(offsets[np.linalg.norm(offsets * grid.spacing_mm, axis=1) <= radius_mm])


def _box(markers: NDArray[np.int32], grid: Grid, beyond_mm: float) -> tuple[slice, slice, slice]:
    """Find the bounding box of the markers, widened by `beyond_mm` within the image."""
    bounds = ndimage.find_objects((markers > 0).view(np.int8))[0]
    beyond = np.ceil(beyond_mm / grid.spacing_mm).astype(int)
    x, y, z = (
        slice(max(part.start - int(b), 0), min(part.stop + int(b), n))
        for part, b, n in zip(bounds, beyond, grid.shape, strict=True)
    )
    return x, y, z
