"""Gauss–Newton normal equations of LC2: which small motion of the model explains the slices better.

With the coefficients α, β, γ of every patch's fit fixed (see `lc2`), 1 − S is a weighted sum of squared
residuals u − α·a − β·b − γ, and a and b change with the pose by their gradients. Every pixel lies in many
patches; what it needs of their coefficients are seven sums, which come from integral images of differences as
the window sums do.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .compiled import inlined, kernel
from .lc2 import (
    INVERSE_COUNT,
    MEAN_U,
    VAR_U,
    WEIGHT,
    Bools,
    Floats,
    Ints,
    PatchedSlices,
    PlacedModel,
    box_of,
    integrate_products,
    patch_moments,
    volume_cell,
)

ALPHA2, ALPHA_BETA, BETA2, ALPHA, BETA, ALPHA_GAMMA, BETA_GAMMA = range(7)
"""Columns of the sums of c·α², c·αβ, c·β², c·α, c·β, c·αγ, c·βγ over a pixel's patches, c = w/(n·Var u)."""
COEFFICIENT_SUMS = 7
TRIANGLE = 21
"""Columns of a slice's result: the lower triangle of JᵀJ by rows comes first, then the 6 of Jᵀr, …"""
STEP_SCORE, STEP_WEIGHT = TRIANGLE + 6, TRIANGLE + 7
"""… then Σ w·S and Σ w."""
STEP_SUMS = TRIANGLE + 8

Vector6 = tuple[float, float, float, float, float, float]


class RigidMotion(NamedTuple):
    """How pixels move with the pose.

    Attributes:
        mm_from_pixel: (s, 3, 3) mm from the centre of rotation, target frame, from (column, row, 1).
        index_from_mm: (3, 3) voxel steps of a mm step.
        radius_mm: what turns rotation into mm.
    """

    mm_from_pixel: Floats
    index_from_mm: Floats
    radius_mm: float


class StepScratch(NamedTuple):
    """Memory of the caller.

    Attributes:
        values: (s, rows, columns, 2); gradients: (s, rows, columns, 6).
        tables: (s, rows + 1, columns + 1, SUMS); coefficients: (s, rows + 1, columns + 1, COEFFICIENT_SUMS).
    """

    values: Floats
    gradients: Floats
    tables: Floats
    coefficients: Floats


@kernel
def sample_gradients(
    channels: NDArray[np.float32], phase: int, matrix: Floats, mask: Bools, values: Floats, gradients: Floats
) -> None:
    """Trilinear values and gradients of both channels at every masked pixel.

    Args:
        channels: (n, nx, ny, nz, 2); phase: which of the n volumes.
        matrix: (3, 3) voxel index from (column, row, 1).
        mask: (rows, columns).
        values: (rows, columns, 2) out, as `sample_channels`.
        gradients: (rows, columns, 6) out: ∇a then ∇b per voxel; 0 outside the mask.
    """
    volume = channels[phase]
    for r in range(mask.shape[0]):
        for c in range(mask.shape[1]):
            for q in range(6):
                gradients[r, c, q] = 0.0
            values[r, c, 0] = 0.0
            values[r, c, 1] = 0.0
            if not mask[r, c]:
                continue
            # where a coordinate is beyond the volume the border value goes on: no change along that axis
            (i, j, k), (fx, fy, fz), (move_x, move_y, move_z) = volume_cell(volume.shape, matrix, r, c)
            for ch in range(2):
                # rows along z: value and difference at the four edges of the cell
                v00, s00 = volume[i, j, k, ch], volume[i, j, k + 1, ch] - volume[i, j, k, ch]
                v01, s01 = volume[i, j + 1, k, ch], volume[i, j + 1, k + 1, ch] - volume[i, j + 1, k, ch]
                v10, s10 = volume[i + 1, j, k, ch], volume[i + 1, j, k + 1, ch] - volume[i + 1, j, k, ch]
                v11 = volume[i + 1, j + 1, k, ch]
                s11 = volume[i + 1, j + 1, k + 1, ch] - v11
                e00, e01, e10, e11 = v00 + fz * s00, v01 + fz * s01, v10 + fz * s10, v11 + fz * s11
                near, far = e00 + fy * (e01 - e00), e10 + fy * (e11 - e10)
                values[r, c, ch] = near + fx * (far - near)
                if move_x:
                    gradients[r, c, 3 * ch] = far - near
                if move_y:
                    gradients[r, c, 3 * ch + 1] = (1 - fx) * (e01 - e00) + fx * (e11 - e10)
                if move_z:
                    gradients[r, c, 3 * ch + 2] = (1 - fx) * ((1 - fy) * s00 + fy * s01) + fx * (
                        (1 - fy) * s10 + fy * s11
                    )


@inlined
def _add_sums(
    coefficients: Floats,
    r: int,
    c: int,
    sign: float,
    sums: tuple[float, float, float, float, float, float, float],
) -> None:
    for q in range(COEFFICIENT_SUMS):
        coefficients[r, c, q] += sign * sums[q]


@inlined
def _integrate(coefficients: Floats) -> None:
    """Differences at the corners of windows, summed over rows and columns, in place."""
    for r in range(coefficients.shape[0]):
        for c in range(coefficients.shape[1]):
            for q in range(COEFFICIENT_SUMS):
                if r > 0:
                    coefficients[r, c, q] += coefficients[r - 1, c, q]
                if c > 0:
                    coefficients[r, c, q] += coefficients[r, c - 1, q]
                if r > 0 and c > 0:
                    coefficients[r, c, q] -= coefficients[r - 1, c - 1, q]


@kernel
def fit_patches(
    table: Floats, boxes: Ints, moments: Floats, begin: int, end: int, coefficients: Floats
) -> tuple[float, float]:
    """Fit patches begin <= p < end and add up what pixels need of their coefficients.

    Args:
        table: integral images of `integrate_products`.
        boxes, moments: (p, 4), (p, 4) as in `PatchedSlices`.
        coefficients: (rows + 1, columns + 1, COEFFICIENT_SUMS) out: at a pixel the sums over its patches.
    Returns:
        Σ w·S and Σ w.
    """
    for r in range(coefficients.shape[0]):
        for c in range(coefficients.shape[1]):
            for q in range(COEFFICIENT_SUMS):
                coefficients[r, c, q] = 0.0
    score, total = 0.0, 0.0
    for p in range(begin, end):
        box = box_of(boxes, p)
        inverse, mean_u, var_u = moments[p, INVERSE_COUNT], moments[p, MEAN_U], moments[p, VAR_U]
        a, b, aa, bb, ab, ua, ub = patch_moments(table, box, inverse, mean_u)
        determinant = aa * bb - ab * ab
        alpha, beta = (ua * bb - ub * ab) / determinant, (ub * aa - ua * ab) / determinant
        gamma = mean_u - alpha * a - beta * b
        w = moments[p, WEIGHT]
        score += w * min(max((alpha * ua + beta * ub) / var_u, 0.0), 1.0)
        total += w
        c = w * inverse / var_u
        sums = (
            c * alpha * alpha,
            c * alpha * beta,
            c * beta * beta,
            c * alpha,
            c * beta,
            c * alpha * gamma,
            c * beta * gamma,
        )
        _add_sums(coefficients, box[0], box[2], 1.0, sums)
        _add_sums(coefficients, box[1], box[2], -1.0, sums)
        _add_sums(coefficients, box[0], box[3], -1.0, sums)
        _add_sums(coefficients, box[1], box[3], 1.0, sums)
    _integrate(coefficients)
    return score, total


@inlined
def _pose_derivative(
    gradient: Floats, first: int, index_from_mm: Floats, x: float, y: float, z: float, per_radius: float
) -> Vector6:
    """Change of a channel with rotation (about the centre, in mm at the radius) and translation.

    Args:
        gradient: (6,) of both channels per voxel; `first`: 0 for a, 3 for b.
    """
    m, g, h, k = index_from_mm, gradient[first], gradient[first + 1], gradient[first + 2]
    gx = m[0, 0] * g + m[1, 0] * h + m[2, 0] * k
    gy = m[0, 1] * g + m[1, 1] * h + m[2, 1] * k
    gz = m[0, 2] * g + m[1, 2] * h + m[2, 2] * k
    return (
        (y * gz - z * gy) * per_radius,
        (z * gx - x * gz) * per_radius,
        (x * gy - y * gx) * per_radius,
        gx,
        gy,
        gz,
    )


@kernel
def add_normal_equations(
    image: NDArray[np.float32],
    mask: Bools,
    mm_from_pixel: Floats,
    index_from_mm: Floats,
    radius_mm: float,
    values: Floats,
    gradients: Floats,
    coefficients: Floats,
    out: Floats,
) -> None:
    """Normal equations of one slice: the lower triangle of JᵀJ and Jᵀr, summed over its pixels.

    Args:
        mm_from_pixel, index_from_mm, radius_mm: as in `RigidMotion`, of this slice.
        values, gradients, coefficients: of this slice, as in `StepScratch`.
        out: (STEP_SUMS,) of which the first STEP_SCORE are filled.
    """
    out[:STEP_SCORE] = 0.0
    place = mm_from_pixel
    for r in range(image.shape[0]):
        for c in range(image.shape[1]):
            if not mask[r, c]:
                continue
            x = place[0, 0] * c + place[0, 1] * r + place[0, 2]
            y = place[1, 0] * c + place[1, 1] * r + place[1, 2]
            z = place[2, 0] * c + place[2, 1] * r + place[2, 2]
            ja = _pose_derivative(gradients[r, c], 0, index_from_mm, x, y, z, 1.0 / radius_mm)
            jb = _pose_derivative(gradients[r, c], 3, index_from_mm, x, y, z, 1.0 / radius_mm)
            fit, u, a, b = coefficients[r, c], image[r, c], values[r, c, 0], values[r, c, 1]
            ra = u * fit[ALPHA] - a * fit[ALPHA2] - b * fit[ALPHA_BETA] - fit[ALPHA_GAMMA]
            rb = u * fit[BETA] - a * fit[ALPHA_BETA] - b * fit[BETA2] - fit[BETA_GAMMA]
            q = 0
            for i in range(6):
                for j in range(i + 1):
                    out[q] += (
                        fit[ALPHA2] * ja[i] * ja[j]
                        + fit[ALPHA_BETA] * (ja[i] * jb[j] + jb[i] * ja[j])
                        + fit[BETA2] * jb[i] * jb[j]
                    )
                    q += 1
            for i in range(6):
                out[TRIANGLE + i] += ra * ja[i] + rb * jb[i]


@kernel
def lc2_normal_slices(
    slices: PatchedSlices,
    model: PlacedModel,
    motion: RigidMotion,
    scratch: StepScratch,
    out: Floats,
    begin: int,
    end: int,
) -> None:
    """Normal equations of slices begin <= s < end. Several ranges may run at once.

    Args:
        out: (s, STEP_SUMS) filled with the normal equations of Σ w(1 − S), then Σ w·S and Σ w.
    """
    for s in range(begin, end):
        image, mask = slices.images[s], slices.masks[s]
        values, gradients = scratch.values[s], scratch.gradients[s]
        table, coefficients = scratch.tables[s], scratch.coefficients[s]
        sample_gradients(model.channels, model.phases[s], model.index_from_pixel[s], mask, values, gradients)
        integrate_products(image, values, table)
        first, last = slices.first_patch[s], slices.first_patch[s + 1]
        out[s, STEP_SCORE], out[s, STEP_WEIGHT] = fit_patches(
            table, slices.boxes, slices.moments, first, last, coefficients
        )
        add_normal_equations(
            image,
            mask,
            motion.mm_from_pixel[s],
            motion.index_from_mm,
            motion.radius_mm,
            values,
            gradients,
            coefficients,
            out[s],
        )
