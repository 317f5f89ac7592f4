"""LC2's force on parts of slices: each slice is sampled and its patches fitted once, whatever its parts.

A part is some of a slice's patches. A pixel that patches of several parts cover counts in each of them, with
those patches alone; the forces on the parts of a slice add up to that on the slice.
"""

from typing import NamedTuple

import numpy as np

from .compiled import kernel
from .lanes import load4, store4
from .lc2 import PIXEL, SUMS, WEIGHT, Floats, Ints, PatchedSlices, PlacedModel, Scratch, fit_patches
from .lc2_step import STEP_SCORE, STEP_WEIGHT, add_forces, sample_gradients


class SliceParts(NamedTuple):
    """Parts of slices.

    Attributes:
        first_part: (s + 1,) where each slice's parts begin.
        order: (p,) patch after patch of the parts, its place among the patches of its slice.
        cut: the parts as slices: what of a slice's runs their patches cover, in the slices' own pixels.
    """

    first_part: Ints
    order: Ints
    cut: PatchedSlices


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
    """Score and force of the parts of slices begin <= s < end. Several ranges may run at once.

    Args:
        ordered: (workers, most patches of a slice, SUMS) scratch: fits, part after part.
        out: (parts, STEP_SUMS) filled with Σ h f, Σ w·S, Σ w, and zeros.
        worker: whose part of the scratch is used.
    """
    samples, window = scratch.samples[worker], scratch.window[worker]
    columns, fits = scratch.columns[worker], scratch.fits[worker]
    own, cut = ordered[worker], parts.cut
    for s in range(begin, end):
        if parts.first_part[s] == parts.first_part[s + 1]:
            continue
        runs, patch = slices.runs[slices.first_run[s] : slices.first_run[s + 1]], slices.first_patch[s]
        sample_gradients(model.channels, model.phases[s], model.index_from_pixel[s], runs, samples)
        fit_patches(slices, s, samples, window, columns, fits)
        for p in range(patch, slices.first_patch[s + 1]):
            at, place = np.uintp(parts.order[p]), np.uintp(p - patch)
            for q in (np.uintp(0), np.uintp(4)):
                store4(own, place, q, load4(fits, at, q))
        for part in range(parts.first_part[s], parts.first_part[s + 1]):
            first = cut.first_patch[part]
            out[part, :] = 0.0
            for p in range(first, cut.first_patch[part + 1]):
                out[part, STEP_SCORE] += own[p - patch, SUMS - 1]
                out[part, STEP_WEIGHT] += cut.moments[p, WEIGHT]
            pixel = cut.runs[cut.first_run[part], PIXEL] - runs[0, PIXEL]
            add_forces(cut, part, samples[pixel:], columns, own[first - patch :], out[part], False)
