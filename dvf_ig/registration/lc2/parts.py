"""Parts of slices as LC2's kernels want them: some of the patches of a slice, and the pixels they cover."""

import numpy as np

from dvf_ig.core import IntArray
from dvf_ig.kernels.lc2.parts import SliceParts
from dvf_ig.kernels.lc2.slices import FIRST, LAST, PATCH_COLUMN, PATCH_ROW, PIXEL, ROW, PatchedSlices


def slice_parts(slices: PatchedSlices, owner: IntArray, part: IntArray) -> SliceParts:
    """Sort the patches of every slice by parts.

    Args:
        owner: (k,) of which slice each part is, ascending.
        part: (p,) which part each patch belongs to; none is empty.
    """
    order = np.argsort(part, kind="stable")
    first_patch = np.searchsorted(part[order], np.arange(len(owner) + 1))
    centers = np.ascontiguousarray(slices.centers[order])
    first_run, runs = _covered_runs(slices, owner, part[order], centers)
    cut = PatchedSlices(
        slices.pixels,
        first_run,
        runs,
        first_patch,
        centers,
        np.ascontiguousarray(slices.moments[order]),
        slices.radius,
    )
    first_part = np.searchsorted(owner, np.arange(len(slices.first_run)))
    return SliceParts(first_part, order - slices.first_patch[owner[part[order]]], cut)


def _covered_runs(
    slices: PatchedSlices, owner: IntArray, part: IntArray, centers: IntArray
) -> tuple[IntArray, IntArray]:
    """Where each part's runs begin, and runs (k, 4) from the first to the last column that its patches cover.

    Args:
        part: (p,) ascending; centers: (p, 2) of each part by rows.
    """
    radius = slices.radius
    rows = 1 + max(
        int(slices.runs[:, ROW].max(initial=0)), int(centers[:, PATCH_ROW].max(initial=0)) + radius
    )
    in_row = part * rows + centers[:, PATCH_ROW]
    begins = np.flatnonzero(np.diff(in_row, prepend=-1))
    ends = np.append(begins[1:], len(in_row)) - 1
    low = np.full(len(owner) * rows, np.iinfo(np.int64).max)
    high = np.full(len(owner) * rows, -1)
    for down in range(-radius, radius + 1):
        there = centers[begins, PATCH_ROW] + down >= 0
        at = in_row[begins[there]] + down
        low[at] = np.minimum(low[at], centers[begins[there], PATCH_COLUMN] - radius)
        high[at] = np.maximum(high[at], centers[ends[there], PATCH_COLUMN] + radius + 1)
    covered = np.flatnonzero(high >= 0)
    whose, row = np.divmod(covered, rows)
    run_row = np.repeat(np.arange(len(slices.first_run) - 1), np.diff(slices.first_run)) * rows
    run_row += slices.runs[:, ROW]
    first, last = (np.searchsorted(run_row, owner[whose] * rows + row, side) for side in ("left", "right"))
    # a row of a slice may have several runs
    count = last - first
    pair = np.repeat(np.arange(len(covered)), count)
    runs = slices.runs[np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count) + first[pair]]
    begin = np.maximum(runs[:, FIRST], low[covered[pair]])
    end = np.minimum(runs[:, LAST], high[covered[pair]])
    pixel = runs[:, PIXEL] + begin - runs[:, FIRST]
    kept = begin < end
    out = np.column_stack([row[pair], begin, end, pixel])[kept]
    return np.searchsorted(whose[pair][kept], np.arange(len(owner) + 1)), out
