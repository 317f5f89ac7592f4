"""LC2's force on parts of slices at several poses: a slice is sampled and fitted once a pose for all parts.

A part is some of a slice's patches. A pixel that patches of several parts cover counts in each of them, with
those patches alone; the forces on the parts of a slice add up to that on the slice. All poses of a slice come
one after the other: poses some millimetres apart read the same part of the model, which then is in cache.
"""

from typing import NamedTuple

import numpy as np

from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.lanes import load4, store4

from .slices import PIXEL, SUMS, WEIGHT, Floats, Ints, PatchedSlices, PlacedModel, Scratch, fit_patches
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
