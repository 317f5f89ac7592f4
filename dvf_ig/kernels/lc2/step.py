"""Gradient and Gauss–Newton matrix of LC2: the small motion of the model that explains the slices better.

With the coefficients α, β, γ of every patch's fit fixed (see `slices`), 1 − S is a weighted sum of squared
residuals u − α·a − β·b − γ, and a and b change with the pose by their gradients. Every pixel lies in many
patches; the seven sums of their coefficients that it needs are running sums, as those of windows are.

A small motion moves a pixel by a linear function of h = (column, row, 1). So a slice needs no more than
Σ h f of the force f = r_a ∇a + r_b ∇b that its residuals exert on the model, and for the matrix Σ h hᵀ G of
G = Σ_patches c (α∇a + β∇b)(α∇a + β∇b)ᵀ; their effect on the pose follows from the slice's position.
"""

import numpy as np
from numpy.typing import NDArray

from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.lanes import add, fma, load4, multiply, pack, pair_sums, scale, store4, subtract, unpack

from .slices import (
    AHEAD,
    FIRST,
    LAST,
    PATCH_COLUMN,
    PATCH_ROW,
    PIXEL,
    ROW,
    Floats,
    Ints,
    PatchedSlices,
    PlacedModel,
    Scratch,
    edge_rows,
    fetch_ahead,
    fit_patches,
    volume_cell,
)

FORCE = 9
"""First columns of a slice's result: Σ h f, (3, 3) with h along rows …"""
STEP_SCORE, STEP_WEIGHT = FORCE, FORCE + 1
"""… then Σ w·S and Σ w …"""
MATRIX = FORCE + 2
"""… and start of Σ h hᵀ G, (6, 6): lower triangles by rows, of h hᵀ along rows, of G along columns."""
STEP_SUMS = MATRIX + 36


@kernel
def sample_gradients(
    channels: NDArray[np.float32], phase: int, matrix: Floats, runs: Ints, samples: Floats
) -> None:
    """Interpolate values and gradients of both channels at every pixel of one slice.

    Args:
        channels, phase, matrix, runs: as in `sample_channels`.
        samples: (pixels, SUMS) out: a, b and their gradients per voxel, see `Scratch`.
    """
    shape, first = channels.shape[1:], runs[0, PIXEL]
    for run in range(len(runs)):
        row, begin, last = runs[run, ROW], runs[run, FIRST], runs[run, LAST]
        pixel = runs[run, PIXEL] - first
        for column in range(begin, last):
            fetch_ahead(channels, phase, matrix, row, min(column + AHEAD, last - 1))
            cell, (fx, fy, fz), (in_x, in_y, in_z) = volume_cell(shape, matrix, row, column)
            e00, e01, e10, e11 = edge_rows(channels, phase, cell)
            s0, s1 = subtract(e01, e00), subtract(e11, e10)
            near, far = fma(e00, fy, s0), fma(e10, fy, s1)
            along_x, along_y = subtract(far, near), fma(s0, fx, subtract(s1, s0))
            value = fma(near, fx, along_x)
            along_z = multiply(value, pack(-1.0, -1.0, 1.0, 1.0))
            # outside the volume the border value continues: no change along that axis
            if not in_x:
                along_x = scale(0.0, along_x)
            if not in_y:
                along_y = scale(0.0, along_y)
            if not in_z:
                along_z = scale(0.0, along_z)
            z = pack(1.0 - fz, 1.0 - fz, fz, fz)
            at = np.uintp(pixel + column - begin)
            store4(samples, at, np.uintp(0), pair_sums(multiply(value, z), multiply(along_x, z)))
            store4(samples, at, np.uintp(4), pair_sums(multiply(along_y, z), along_z))


@inlined
def _add_fits(slices: PatchedSlices, patch: int, at: int, fits: Floats, columns: Floats, sign: float) -> None:
    """Add a patch's coefficients to its column."""
    place = np.uintp((slices.centers[patch, PATCH_COLUMN] >> 1) + slices.radius)
    for q in (np.uintp(0), np.uintp(4)):
        total = fma(load4(columns, place, q), sign, load4(fits, np.uintp(at), q))
        store4(columns, place, q, total)


@inlined
def _add_matrix(
    out: Floats,
    row: int,
    column: int,
    aa: float,
    ab: float,
    bb: float,
    a: tuple[float, float, float],
    b: tuple[float, float, float],
) -> None:
    """Add one pixel's part of Σ h hᵀ G."""
    h = (float(column), float(row), 1.0)
    at = MATRIX
    for i in range(3):
        for j in range(i + 1):
            hh = h[i] * h[j]
            for k in range(3):
                for m in range(k + 1):
                    g = aa * a[k] * a[m] + ab * (a[k] * b[m] + b[k] * a[m]) + bb * b[k] * b[m]
                    out[at] += hh * g
                    at += 1


@inlined
def _add_forces(
    slices: PatchedSlices, run: int, first: int, samples: Floats, columns: Floats, out: Floats, matrix: bool
) -> None:
    """Add the pixels of one run to a slice's sums."""
    runs, radius = slices.runs, slices.radius
    row, begin, pixel = runs[run, ROW], runs[run, FIRST], runs[run, PIXEL]
    x = y = z = cx = cy = cz = 0.0
    for column in range(begin, runs[run, LAST]):
        # patches centred on columns from column − radius to column + radius
        low = ((column - radius + 1) >> 1) + radius
        s0, s1 = load4(columns, np.uintp(low), np.uintp(0)), load4(columns, np.uintp(low), np.uintp(4))
        for k in range(low + 1, ((column + radius) >> 1) + radius + 1):
            s0 = add(s0, load4(columns, np.uintp(k), np.uintp(0)))
            s1 = add(s1, load4(columns, np.uintp(k), np.uintp(4)))
        caa, cab, cbb, ca = unpack(s0)
        cb, cag, cbg, _ = unpack(s1)
        at = pixel + column - begin
        u = float(slices.pixels[at])
        a, b, ax, bx = unpack(load4(samples, np.uintp(at - first), np.uintp(0)))
        ay, by, az, bz = unpack(load4(samples, np.uintp(at - first), np.uintp(4)))
        ra = u * ca - a * caa - b * cab - cag
        rb = u * cb - a * cab - b * cbb - cbg
        fx, fy, fz = ra * ax + rb * bx, ra * ay + rb * by, ra * az + rb * bz
        x, y, z = x + fx, y + fy, z + fz
        cx, cy, cz = cx + column * fx, cy + column * fy, cz + column * fz
        if matrix:
            _add_matrix(out, row, column, caa, cab, cbb, (ax, ay, az), (bx, by, bz))
    for k, (along, total) in enumerate(((cx, x), (cy, y), (cz, z))):
        out[k] += along
        out[3 + k] += row * total
        out[6 + k] += total


@kernel
def add_forces(
    slices: PatchedSlices, s: int, samples: Floats, columns: Floats, fits: Floats, out: Floats, matrix: bool
) -> None:
    """Add up Σ h f of one slice, and with `matrix` Σ h hᵀ G.

    Args:
        samples, columns, fits: one worker's part of `Scratch`, filled by `sample_gradients`, `fit_patches`.
        out: (STEP_SUMS,) added to in place.
    """
    runs, radius, centers = slices.runs, slices.radius, slices.centers
    first, end = slices.first_run[s], slices.first_run[s + 1]
    patch, last_patch = slices.first_patch[s], slices.first_patch[s + 1]
    added = dropped = patch
    columns[:] = 0.0
    for run in range(first, end):
        row = runs[run, ROW]
        while added < last_patch and centers[added, PATCH_ROW] <= row + radius:
            _add_fits(slices, added, added - patch, fits, columns, 1.0)
            added += 1
        while dropped < added and centers[dropped, PATCH_ROW] < row - radius:
            _add_fits(slices, dropped, dropped - patch, fits, columns, -1.0)
            dropped += 1
        _add_forces(slices, run, runs[first, PIXEL], samples, columns, out, matrix)


@kernel
def lc2_step_slices(
    slices: PatchedSlices,
    model: PlacedModel,
    scratch: Scratch,
    matrix: bool,
    out: Floats,
    worker: int,
    begin: int,
    end: int,
) -> None:
    """Score slices begin <= s < end, with their forces; ranges may run in parallel.

    Args:
        matrix: whether Σ h hᵀ G is needed.
        out: (s, STEP_SUMS) filled with Σ h f, Σ w·S, Σ w, and Σ h hᵀ G or zeros.
        worker: index of the part of the scratch that is used.
    """
    samples, window = scratch.samples[worker], scratch.window[worker]
    columns, fits = scratch.columns[worker], scratch.fits[worker]
    for s in range(begin, end):
        runs = slices.runs[slices.first_run[s] : slices.first_run[s + 1]]
        out[s, :] = 0.0
        if len(runs) == 0:
            continue
        sample_gradients(model.channels, model.phases[s], model.index_from_pixel[s], runs, samples)
        out[s, STEP_SCORE], out[s, STEP_WEIGHT] = fit_patches(slices, s, samples, window, columns, fits)
        add_forces(slices, s, samples, columns, fits, out[s], matrix)
