"""Labels of end-diastole at one pitch, and the motion from every phase back to them, for a model's file."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import ndimage

from dvf_ig.core import AnyArray, FloatArray, Grid, Mesh, Preop, Tissue, Volume, VolumeSeries, Warp
from dvf_ig.core.space.warp import CELLS, knots

from .motion.free_form import FreeForm, Lattice
from .motion.image_match import FreeFormOptions, match_images
from .motion.slice_stack import observable_axes

LABEL_MM, MARGIN_MM = 1.5, 6.0
"""Pitch of the labels kept, and margin around the surface at end-diastole and at all phases."""
INVERSE_STEPS = 12
MATCH_MM = 4.0
"""Pitch of the label voxels that are compared, and their blur."""
FROM_LABELS = FreeFormOptions(pitch_mm=12.0, blurs_mm=(MATCH_MM,), steps=4)
RIM = 4
"""Label voxels around the organ that are compared."""

Move = Callable[[FloatArray], FloatArray]


def tissue_of_cine(
    labels: Volume,
    names: Sequence[tuple[int, str]],
    reference: Sequence[Mesh],
    phase: int,
    moves: Sequence[Move],
) -> Tissue:
    """Keep labels of one phase and invert the motion that leads from it.

    Args:
        labels: of the phase `phase`; reference: the organ's surface in every phase.
        moves: one for each phase: (n, 3) places at `phase` to that material's places then.
    """

    def back(i: int, places_mm: FloatArray) -> FloatArray:
        origin_mm = places_mm
        for _ in range(INVERSE_STEPS):
            origin_mm = origin_mm + places_mm - moves[i](origin_mm)
        return origin_mm

    return _tissue(labels, names, reference, phase, back)


def tissue_of_labels(preop: Preop, reference: Sequence[Mesh], phase: int) -> Tissue | None:
    """Keep labels of one phase, and estimate the motion from the labels of every phase; None for a stack.

    What no label shows, such as torsion, is not in the motion.
    """
    series = preop.labels
    if series is None or not observable_axes(series.grid.spacing_mm).all():
        return None
    pulls = _matched(series, preop.blood_labels, phase)

    def back(i: int, places_mm: FloatArray) -> FloatArray:
        return pulls[i].move(places_mm)

    return _tissue(series.phase(phase), preop.label_names, reference, phase, back)


def _matched(series: VolumeSeries, blood: Sequence[int], phase: int) -> list[FreeForm]:
    """Match every phase to one, in two chains from it, on a coarse map of background, wall and blood."""
    step = [max(1, round(MATCH_MM / one)) for one in series.grid.spacing_mm.tolist()]
    level = (np.arange(256) > 0) + np.isin(np.arange(256), blood)
    grey = np.stack([_coarse(level[values], step) for values in series.values])
    whole = series.grid
    grid = Grid(whole.frame, grey.shape[1:], whole.origin_mm, whole.spacing_mm * step, whole.direction)
    count, identity = len(grey), FreeForm.identity(Lattice.over(grid, FROM_LABELS.pitch_mm))
    pulls = [identity] * count
    half = count // 2
    for order in (range(1, half + 1), range(count - 1, half, -1)):
        before = identity
        for k in order:
            i = (phase + k) % count
            mask = ndimage.binary_dilation(grey[i] > 0.5, iterations=RIM)
            before = pulls[i] = match_images(grey[i], grey[phase], mask, before, FROM_LABELS)
    return pulls


def _coarse(values: AnyArray, step: Sequence[int]) -> FloatArray:
    """Average (nx, ny, nz) values about every few voxels along each axis."""
    mean = ndimage.uniform_filter(values.astype(np.float32), [2 * n - 1 for n in step])
    return np.asarray(mean[:: step[0], :: step[1], :: step[2]])


def _tissue(
    labels: Volume,
    names: Sequence[tuple[int, str]],
    reference: Sequence[Mesh],
    phase: int,
    back: Callable[[int, FloatArray], FloatArray],
) -> Tissue:
    frame = labels.grid.frame
    low, high = _box(reference)
    side_mm = float((high - low).max())
    knot_mm, origin_mm = side_mm / CELLS, 0.5 * (low + high - side_mm)
    places_mm = knots(origin_mm, knot_mm)
    motion = []
    for i in range(len(reference)):
        pull_mm = np.zeros_like(places_mm) if i == phase else places_mm - back(i, places_mm)
        motion.append(Warp.through(frame, origin_mm, knot_mm, pull_mm, np.zeros(len(places_mm))))
    return Tissue(_resampled(labels, *_box(reference[phase : phase + 1])), tuple(names), tuple(motion))


def _box(surfaces: Sequence[Mesh]) -> tuple[FloatArray, FloatArray]:
    """Find the corners of the box about surfaces, with the margin."""
    low = np.min([mesh.vertices_mm.min(axis=0) for mesh in surfaces], axis=0) - MARGIN_MM
    return low, np.max([mesh.vertices_mm.max(axis=0) for mesh in surfaces], axis=0) + MARGIN_MM


def _resampled(labels: Volume, low: FloatArray, high: FloatArray) -> Volume:
    """Take the nearest labels on an axis-aligned grid of LABEL_MM; 0 outside the image."""
    nx, ny, nz = (int(n) for n in np.ceil((high - low) / LABEL_MM) + 1)
    grid = Grid.axis_aligned(labels.grid.frame, (nx, ny, nz), low, LABEL_MM)
    index = labels.grid.to_index(grid.centers_mm())
    values = labels.values[labels.grid.nearest(index)]
    return Volume(grid, np.where(labels.grid.holds(index, 0.5), values, 0).astype(np.uint8))
