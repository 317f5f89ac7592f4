"""LC2 of a 3-D image with cubic patches and any number of channels, and its exact gradient over the pose.

In each patch the ultrasound u is fitted by Σ βᵢ·mᵢ + γ, where mᵢ are channels of the model at the same
position: grey levels and gradient magnitude of one or several images. The patch scores S = 1 −
Var(residual)/Var(u), with a ridge on the channels' variances.

Voxels are sorted by blocks, cubes of a few voxels; a patch is eight blocks that meet in a corner. A block's
sums are taken once and added to its patches: the cost depends on neither patch size nor empty space. With β
fixed S is stationary in β, hence dS/dmᵢ at a voxel is 2·βᵢ·residual/(n·Var u) (see `force_blocks`). Blocks
and patches write their own rows: results are the same at any thread count.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvf_ig.kernels.compiled import inlined, kernel

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]

CORNERS = 8
RIDGE = 1e-3
"""Added to the channels' variances; the channels are scaled to unit variance over the model's volume."""
INVERSE_COUNT, MEAN_U, VAR_U = range(3)
"""Columns of a patch's moments that depend only on the ultrasound."""
BLOCK_MOMENT, BLOCK_STIFFNESS = 3, 12
"""First columns of Σ y·fᵀ and of the upper triangle of Σ ∇m·B·∇mᵀ of a block; Σ f comes before."""
BLOCK_COLUMNS = 18


class BlockedVoxels(NamedTuple):
    """Insonified voxels, block by block.

    Attributes:
        place: (n, 3) float32 voxel index in the ultrasound's grid.
        u: (n,) float32.
        first: (b + 1,) start of each block's voxels.
        block_of_patch: (p, 8) blocks of each patch, −1 for none.
        patch_of_block: (b, 8) patches of each block, −1 for none.
        moments: (p, 3) one over the voxel count, mean and variance of u.
    """

    place: Floats32
    u: Floats32
    first: Ints
    block_of_patch: Ints
    patch_of_block: Ints
    moments: Floats


def sum_count(channels: int) -> int:
    """Count a block's sums: mᵢ, u·mᵢ, and mᵢ·mⱼ for j ≤ i; a patch returns as many coefficients to it."""
    return 2 * channels + channels * (channels + 1) // 2


@inlined
def _cell(x: float, last: int) -> tuple[int, float, bool]:
    """Find the voxel below x along one axis, the fraction beyond it, and whether x is in [0, last]."""
    inside = 0.0 <= x <= last
    x = min(max(x, 0.0), float(last))
    i = min(int(x), last - 1)
    return i, x - i, inside


@kernel
def sample_blocks(
    voxels: BlockedVoxels,
    channels: Floats32,
    matrix: Floats,
    blocks: Ints,
    slopes: bool,
    values: Floats32,
    gradients: Floats32,
    sums: Floats,
    begin: int,
    end: int,
) -> None:
    """Sample channels at the voxels of blocks `blocks[begin:end]`, and the blocks' sums.

    Args:
        channels: (nx, ny, nz, c).
        matrix: (3, 4) voxel index in the model from one in the ultrasound.
        blocks: (k,) indices of the blocks that count.
        slopes: whether gradients are computed.
        values: (n, c) out; gradients: (n, c, 3) out, per voxel step of the model, 0 along an axis beyond it.
        sums: (b, sum_count(c) + 1) out; the last column counts voxels inside the model.
    """
    count = channels.shape[3]
    lx, ly, lz = channels.shape[0] - 1, channels.shape[1] - 1, channels.shape[2] - 1
    for q in range(begin, end):
        b = blocks[q]
        row = sums[b]
        row[:] = 0.0
        for v in range(voxels.first[b], voxels.first[b + 1]):
            p, s, t = voxels.place[v, 0], voxels.place[v, 1], voxels.place[v, 2]
            i, fx, in_x = _cell(matrix[0, 0] * p + matrix[0, 1] * s + matrix[0, 2] * t + matrix[0, 3], lx)
            j, fy, in_y = _cell(matrix[1, 0] * p + matrix[1, 1] * s + matrix[1, 2] * t + matrix[1, 3], ly)
            k, fz, in_z = _cell(matrix[2, 0] * p + matrix[2, 1] * s + matrix[2, 2] * t + matrix[2, 3], lz)
            if in_x and in_y and in_z:
                row[-1] += 1.0
            u = voxels.u[v]
            place = 2 * count
            for ch in range(count):
                v00, s00 = channels[i, j, k, ch], channels[i, j, k + 1, ch] - channels[i, j, k, ch]
                v01 = channels[i, j + 1, k, ch]
                s01 = channels[i, j + 1, k + 1, ch] - v01
                v10 = channels[i + 1, j, k, ch]
                s10 = channels[i + 1, j, k + 1, ch] - v10
                v11 = channels[i + 1, j + 1, k, ch]
                s11 = channels[i + 1, j + 1, k + 1, ch] - v11
                e00, e01, e10, e11 = v00 + fz * s00, v01 + fz * s01, v10 + fz * s10, v11 + fz * s11
                near, far = e00 + fy * (e01 - e00), e10 + fy * (e11 - e10)
                m = near + fx * (far - near)
                values[v, ch] = m
                if slopes:
                    gradients[v, ch, 0] = far - near if in_x else 0.0
                    gradients[v, ch, 1] = (1 - fx) * (e01 - e00) + fx * (e11 - e10) if in_y else 0.0
                    gradients[v, ch, 2] = (
                        (1 - fx) * ((1 - fy) * s00 + fy * s01) + fx * ((1 - fy) * s10 + fy * s11)
                        if in_z
                        else 0.0
                    )
                row[ch] += m
                row[count + ch] += u * m
                for other in range(ch + 1):
                    row[place] += m * values[v, other]
                    place += 1


@inlined
def _solved(matrix: Floats, right: Floats, count: int) -> None:
    """Solve in place by Cholesky: `right` becomes the solution. The ridge keeps the matrix definite."""
    for i in range(count):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(max(total, 1e-12)) if i == j else total / matrix[j, j]
    for i in range(count):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]


@kernel
def fit_patches(
    voxels: BlockedVoxels,
    weights: Floats,
    sums: Floats,
    scores: Floats,
    coefficients: Floats,
    begin: int,
    end: int,
) -> None:
    """Fit patches begin <= p < end.

    Args:
        weights: (p,) of each patch; a patch of weight 0 is skipped.
        sums: of `sample_blocks`.
        scores: (p,) out, S.
        coefficients: (p, sum_count(c)) out: k·βᵢ, k·βᵢ·(Σ βⱼ·mean mⱼ − mean u), k·βᵢ·βⱼ with k = w/(n·Var u).
    """
    count = 0
    while 2 * count + count * (count + 1) // 2 < sums.shape[1] - 1:
        count += 1
    row = np.empty(sums.shape[1])
    matrix, beta, right = np.empty((count, count)), np.empty(count), np.empty(count)
    for p in range(begin, end):
        scores[p] = 0.0
        coefficients[p, :] = 0.0
        if weights[p] <= 0.0:
            continue
        row[:] = 0.0
        for corner in range(CORNERS):
            b = voxels.block_of_patch[p, corner]
            if b >= 0:
                for q in range(row.shape[0]):
                    row[q] += sums[b, q]
        inverse, mean_u = voxels.moments[p, INVERSE_COUNT], voxels.moments[p, MEAN_U]
        var_u = voxels.moments[p, VAR_U]
        place = 2 * count
        for i in range(count):
            right[i] = row[count + i] * inverse - mean_u * row[i] * inverse
            beta[i] = right[i]
            for j in range(i + 1):
                matrix[i, j] = row[place] * inverse - row[i] * row[j] * inverse * inverse
                place += 1
            matrix[i, i] += RIDGE
        _solved(matrix, beta, count)
        explained, offset = 0.0, -mean_u
        for i in range(count):
            explained += beta[i] * right[i]
            offset += beta[i] * row[i] * inverse
        scores[p] = min(max(explained / var_u, 0.0), 1.0)
        scale = weights[p] * inverse / var_u
        place = 2 * count
        for i in range(count):
            coefficients[p, i] = scale * beta[i]
            coefficients[p, count + i] = scale * beta[i] * offset
            for j in range(i + 1):
                coefficients[p, place] = scale * beta[i] * beta[j]
                place += 1


@kernel
def force_blocks(
    voxels: BlockedVoxels,
    matrix: Floats,
    blocks: Ints,
    values: Floats32,
    gradients: Floats32,
    coefficients: Floats,
    out: Floats,
    begin: int,
    end: int,
) -> None:
    """Compute how Σ w·S changes as the voxels of blocks `blocks[begin:end]` move through the model.

    At a voxel f = Σᵢ (Σ_patches k·βᵢ·(u − mean u − Σⱼ βⱼ·(mⱼ − mean mⱼ)))·∇mᵢ, half the derivative.

    Args:
        matrix, blocks, values, gradients, coefficients: of `sample_blocks` and `fit_patches`.
        out: (b, BLOCK_COLUMNS): Σ f, Σ y·fᵀ by rows with y the position in the model, Σ ∇m·B·∇mᵀ; voxel
            steps.
    """
    count = values.shape[1]
    fit, square = np.empty(coefficients.shape[1]), np.empty((count, count))
    turned = np.empty(3)
    for q in range(begin, end):
        b = blocks[q]
        fit[:] = 0.0
        for corner in range(CORNERS):
            p = voxels.patch_of_block[b, corner]
            if p >= 0:
                for c in range(fit.shape[0]):
                    fit[c] += coefficients[p, c]
        place = 2 * count
        for i in range(count):
            for j in range(i + 1):
                square[i, j] = square[j, i] = fit[place]
                place += 1
        row = out[b]
        row[:] = 0.0
        for v in range(voxels.first[b], voxels.first[b + 1]):
            u = voxels.u[v]
            fx = fy = fz = 0.0
            for i in range(count):
                pull = u * fit[i] + fit[count + i]
                turned[:] = 0.0
                for j in range(count):
                    pull -= square[i, j] * values[v, j]
                    turned[0] += square[i, j] * gradients[v, j, 0]
                    turned[1] += square[i, j] * gradients[v, j, 1]
                    turned[2] += square[i, j] * gradients[v, j, 2]
                gx, gy, gz = gradients[v, i, 0], gradients[v, i, 1], gradients[v, i, 2]
                fx += pull * gx
                fy += pull * gy
                fz += pull * gz
                row[12] += gx * turned[0]
                row[13] += gx * turned[1]
                row[14] += gx * turned[2]
                row[15] += gy * turned[1]
                row[16] += gy * turned[2]
                row[17] += gz * turned[2]
            p, s, t = voxels.place[v, 0], voxels.place[v, 1], voxels.place[v, 2]
            row[0] += fx
            row[1] += fy
            row[2] += fz
            for axis in range(3):
                y = matrix[axis, 0] * p + matrix[axis, 1] * s + matrix[axis, 2] * t + matrix[axis, 3]
                row[3 + 3 * axis] += y * fx
                row[4 + 3 * axis] += y * fy
                row[5 + 3 * axis] += y * fz
