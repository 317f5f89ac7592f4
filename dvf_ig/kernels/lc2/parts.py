"""LC2's force on parts of slices at several poses: a slice is sampled and fitted once a pose for all parts.

A part is some of a slice's patches. A pixel that patches of several parts cover counts in each of them, with
those patches alone; the forces on the parts of a slice add up to that on the slice. All poses of a slice come
one after the other: poses some millimetres apart read the same part of the model, which then is in cache.
`window_moments` are those of the ultrasound over the patches of the parts.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.lanes import load4, store4

from .slices import (
    FIRST,
    LAST,
    PIXEL,
    ROW,
    SUMS,
    WEIGHT,
    Floats,
    Ints,
    PatchedSlices,
    PlacedModel,
    Scratch,
    fit_patches,
)
from .step import STEP_SCORE, STEP_WEIGHT, add_forces, sample_gradients


class SliceParts(NamedTuple):
    """Parts of slices.

    Attributes:
        first_part: (s + 1,) start of each slice's parts.
        order: (p,) patch after patch of the parts, its index among the patches of its slice.
        cut: the parts as slices: the runs that their patches cover, in the slices' own pixels.
    """

    first_part: Ints
    order: Ints
    cut: PatchedSlices


@inlined
def _add_parts(
    slices: PatchedSlices,
    parts: SliceParts,
    s: int,
    samples: Floats,
    columns: Floats,
    fits: Floats,
    ordered: Floats,
    out: Floats,
) -> None:
    """Add up Σ h f, Σ w·S and Σ w of every part of slice `s`."""
    cut, patch, pixel = parts.cut, slices.first_patch[s], slices.runs[slices.first_run[s], PIXEL]
    for p in range(patch, slices.first_patch[s + 1]):
        at, place = np.uintp(parts.order[p]), np.uintp(p - patch)
        for q in (np.uintp(0), np.uintp(4)):
            store4(ordered, place, q, load4(fits, at, q))
    for part in range(parts.first_part[s], parts.first_part[s + 1]):
        first, begin = cut.first_patch[part], cut.runs[cut.first_run[part], PIXEL] - pixel
        out[part, :] = 0.0
        for p in range(first, cut.first_patch[part + 1]):
            out[part, STEP_SCORE] += ordered[p - patch, SUMS - 1]
            out[part, STEP_WEIGHT] += cut.moments[p, WEIGHT]
        add_forces(cut, part, samples[begin:], columns, ordered[first - patch :], out[part], False)


@kernel
def lc2_step_parts(
    slices: PatchedSlices,
    parts: SliceParts,
    model: PlacedModel,
    scratch: Scratch,
    ordered: Floats,
    out: Floats,
    worker: int,
    begin: int,
    end: int,
) -> None:
    """Score the parts of slices begin <= s < end at m poses, with their forces; ranges may run in parallel.

    Args:
        model: `index_from_pixel` is (m, s, 3, 3).
        ordered: (workers, most patches of a slice, SUMS) scratch: fits, part after part.
        out: (m, parts, MATRIX) filled with Σ h f, Σ w·S, Σ w.
        worker: index of the part of the scratch that is used.
    """
    samples, window = scratch.samples[worker], scratch.window[worker]
    columns, fits = scratch.columns[worker], scratch.fits[worker]
    for s in range(begin, end):
        if parts.first_part[s] == parts.first_part[s + 1]:
            continue
        for pose in range(len(model.index_from_pixel)):
            at_pose = model.index_from_pixel[pose, s]
            runs = slices.runs[slices.first_run[s] : slices.first_run[s + 1]]
            sample_gradients(model.channels, model.phases[s], at_pose, runs, samples)
            fit_patches(slices, s, samples, window, columns, fits)
            _add_parts(slices, parts, s, samples, columns, fits, ordered[worker], out[pose])


@kernel
def window_moments(
    pixels: NDArray[np.float32],
    first_run: Ints,
    runs: Ints,
    radius: int,
    first_center: Ints,
    centers: Ints,
    columns: Floats,
    out: Floats,
) -> None:
    """Compute pixel count, mean and variance over the window about every centre.

    Args:
        pixels, first_run, runs: as in `slices.PatchedSlices`.
        first_center: (s + 1,) start of each slice's centres; centers: (p, 2) row and column, by rows.
        columns: (columns + 2·radius, 3) scratch.
        out: (p, 3).
    """
    for s in range(len(first_run) - 1):
        first, end = first_run[s], first_run[s + 1]
        if first == end:
            continue
        columns[:] = 0.0
        added = dropped = first
        for p in range(first_center[s], first_center[s + 1]):
            row = centers[p, 0]
            while added < end and runs[added, ROW] <= row + radius:
                _add_run(pixels, runs[added], radius, 1.0, columns)
                added += 1
            while dropped < added and runs[dropped, ROW] < row - radius:
                _add_run(pixels, runs[dropped], radius, -1.0, columns)
                dropped += 1
            count = total = squares = 0.0
            for c in range(centers[p, 1], centers[p, 1] + 2 * radius + 1):
                count += columns[c, 0]
                total += columns[c, 1]
                squares += columns[c, 2]
            mean = total / count
            out[p, 0], out[p, 1], out[p, 2] = count, mean, squares / count - mean * mean


@kernel
def _add_run(pixels: NDArray[np.float32], run: Ints, radius: int, sign: float, columns: Floats) -> None:
    """Add a run's pixels to its columns, or subtract them."""
    for k in range(run[LAST] - run[FIRST]):
        u, column = float(pixels[run[PIXEL] + k]), run[FIRST] + k + radius
        columns[column, 0] += sign
        columns[column, 1] += sign * u
        columns[column, 2] += sign * u * u
