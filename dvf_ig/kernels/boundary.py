"""Boundary points against a spline of signed distance: sums of one robust Gauss–Newton step, in one pass.

A point p with in-plane normal n (unit, from dark to bright) is moved to q = R p + t; the spline of its phase
gives the distance d there and its gradient g. With s = +1 where d grows towards the bright side, −1 else,

    r = d − o,   m = max(0, s n·g/|g|),   ω = a m / (1 + r²/σ²)²,   J = [(q − c) × g/ρ, g, −1]

so that a point counts only if its normal agrees with the surface's (Geman–McClure; Black and Rangarajan
1996). The share a m/(1 + r²/σ²), summed, is what the step increases.
`foot_point_distance` gives the signed distances that the splines are fitted to, from a labelled surface.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import BoolArray, FloatArray, IntArray

from .compiled import inlined, kernel
from .lanes import unpack
from .spline import cell_value_gradient, find_cell, inside_box

UNKNOWNS = 7
"""Unknowns: six of the pose (see `registration.pose_chart`), then the uniform offset o."""
RIGHT = UNKNOWNS * UNKNOWNS
"""Start of Jᵀωr in the sums of a step; JᵀωJ comes first, row by row."""
SHARE, MATCHED, SQUARES = RIGHT + UNKNOWNS, RIGHT + UNKNOWNS + 1, RIGHT + UNKNOWNS + 2
"""Offsets of the sum of shares, Σ a m, and Σ ωr²."""
SUMS = RIGHT + UNKNOWNS + 3


class OrientedPoints(NamedTuple):
    """Boundary points before they are moved.

    Attributes:
        points: (n, 3) mm; normals: (n, 3) unit.
        weights: (n,) a.
        phases: (n,) index of the spline with which each is compared.
    """

    points: FloatArray
    normals: FloatArray
    weights: FloatArray
    phases: IntArray


class DistanceSplines(NamedTuple):
    """Signed distance, one spline a phase.

    Attributes:
        coefficients: (k, cx, cy, cz) mm.
        knots_from_mm: (3, 4).
        polarity: s.
    """

    coefficients: NDArray[np.float32]
    knots_from_mm: FloatArray
    polarity: float


@inlined
def _at(
    coefficients: NDArray[np.float32], phase: int, m: FloatArray, x: float, y: float, z: float
) -> tuple[bool, float, float, float, float]:
    """Evaluate the spline: (x, y, z) in its box, distance, gradient per mm. `m`: (3, 4) knots from mm."""
    cells = (coefficients.shape[1] - 3, coefficients.shape[2] - 3, coefficients.shape[3] - 3)
    u = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
    v = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
    w = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    if not inside_box(u, v, w, cells):
        return False, 0.0, 0.0, 0.0, 0.0
    d, a, b, c = unpack(cell_value_gradient(coefficients, np.uintp(phase), find_cell(u, v, w, cells)))
    gx = m[0, 0] * a + m[1, 0] * b + m[2, 0] * c
    gy = m[0, 1] * a + m[1, 1] * b + m[2, 1] * c
    gz = m[0, 2] * a + m[1, 2] * b + m[2, 2] * c
    return True, d, gx, gy, gz


@inlined
def _rotated(pose: FloatArray, vectors: FloatArray, i: int) -> tuple[float, float, float]:
    """Rotate row i: R v."""
    x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z,
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z,
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z,
    )


@inlined
def _agreement(pose: FloatArray, normals: FloatArray, i: int, gx: float, gy: float, gz: float) -> float:
    """Compute the cosine between the moved normal and the gradient; 0 if the gradient vanishes."""
    length = math.sqrt(gx * gx + gy * gy + gz * gz)
    if not length > 1e-6:
        return 0.0
    nx, ny, nz = _rotated(pose, normals, i)
    return (nx * gx + ny * gy + nz * gz) / length


@inlined
def _add_row(out: FloatArray, row: FloatArray, w: float, r: float) -> None:
    """Add one point's part of JᵀωJ (lower half) and Jᵀωr."""
    for j in range(UNKNOWNS):
        wj = w * row[j]
        for k in range(j + 1):
            out[UNKNOWNS * j + k] += wj * row[k]
        out[RIGHT + j] += wj * r


@kernel
def boundary_step_sums(
    boundary: OrientedPoints,
    splines: DistanceSplines,
    pose: FloatArray,
    center_mm: FloatArray,
    radius_mm: float,
    offset_mm: float,
    sigma_mm: float,
    out: FloatArray,
) -> None:
    """Compute the sums of one step; see the module docstring.

    Args:
        pose: (3, 4) R and t.
        center_mm: (3,) c; radius_mm: ρ; offset_mm: o; sigma_mm: σ.
        out: (SUMS,).
    """
    points, normals = boundary.points, boundary.normals
    out[:] = 0.0
    row = np.empty(UNKNOWNS)
    share, matched, squares = 0.0, 0.0, 0.0
    for i in range(len(points)):
        x, y, z = _rotated(pose, points, i)
        x, y, z = x + pose[0, 3], y + pose[1, 3], z + pose[2, 3]
        inside, d, gx, gy, gz = _at(splines.coefficients, boundary.phases[i], splines.knots_from_mm, x, y, z)
        if not inside:
            continue
        agree = _agreement(pose, normals, i, gx, gy, gz) * splines.polarity
        if agree <= 0.0:
            continue
        r = d - offset_mm
        near = 1.0 / (1.0 + r * r / (sigma_mm * sigma_mm))
        a = boundary.weights[i] * agree
        w = a * near * near
        x -= center_mm[0]
        y -= center_mm[1]
        z -= center_mm[2]
        row[0] = (y * gz - z * gy) / radius_mm
        row[1] = (z * gx - x * gz) / radius_mm
        row[2] = (x * gy - y * gx) / radius_mm
        row[3], row[4], row[5], row[6] = gx, gy, gz, -1.0
        _add_row(out, row, w, r)
        share += a * near
        matched += a
        squares += w * r * r
    for j in range(UNKNOWNS):
        for k in range(j):
            out[UNKNOWNS * k + j] = out[UNKNOWNS * j + k]
    out[SHARE], out[MATCHED], out[SQUARES] = share, matched, squares


@kernel
def boundary_residuals(
    boundary: OrientedPoints,
    splines: DistanceSplines,
    pose: FloatArray,
    distance_mm: FloatArray,
    agreement: FloatArray,
) -> None:
    """Compute distance and the normal's agreement at every point, (n,) each; NaN and 0 outside the spline."""
    for i in range(len(boundary.points)):
        x, y, z = _rotated(pose, boundary.points, i)
        x, y, z = x + pose[0, 3], y + pose[1, 3], z + pose[2, 3]
        inside, d, gx, gy, gz = _at(splines.coefficients, boundary.phases[i], splines.knots_from_mm, x, y, z)
        distance_mm[i] = d if inside else math.nan
        agreement[i] = _agreement(pose, boundary.normals, i, gx, gy, gz) * splines.polarity if inside else 0.0


@kernel
def boundary_distances(
    splines: DistanceSplines,
    phases: IntArray,
    points_mm: FloatArray,
    distance_mm: FloatArray,
    gradient: FloatArray,
) -> None:
    """Compute distance (n,) and gradient (n, 3) at (n, 3) places of the model, 0 outside the spline.

    Args:
        phases: (n,) index of the spline of each place.
    """
    for i in range(len(points_mm)):
        x, y, z = points_mm[i, 0], points_mm[i, 1], points_mm[i, 2]
        _, d, gx, gy, gz = _at(splines.coefficients, phases[i], splines.knots_from_mm, x, y, z)
        distance_mm[i], gradient[i, 0], gradient[i, 1], gradient[i, 2] = d, gx, gy, gz


@kernel
def foot_point_distance(
    nearest: NDArray[np.int32],
    row: NDArray[np.int32],
    feet_mm: FloatArray,
    normals: FloatArray,
    inside: BoolArray,
    spacing_mm: FloatArray,
    plane_mm: float,
    out: NDArray[np.float32],
) -> None:
    """Compute the distance: to the plane near it, to the foot point from three times `plane_mm` on.

    Args:
        nearest: (3, nx, ny, nz) index of each voxel's nearest surface voxel.
        row: (nx, ny, nz) number of each surface voxel.
        feet_mm: (n, 3) from a surface voxel to the surface, against its normal; normals: (n, 3) inward.
        inside: (nx, ny, nz).
        plane_mm: distance up to which only the plane counts.
        out: (nx, ny, nz) mm, positive inside.
    """
    nx, ny, nz = out.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                a, b, c = nearest[0, i, j, k], nearest[1, i, j, k], nearest[2, i, j, k]
                r = row[a, b, c]
                x = (i - a) * spacing_mm[0] + feet_mm[r, 0]
                y = (j - b) * spacing_mm[1] + feet_mm[r, 1]
                z = (k - c) * spacing_mm[2] + feet_mm[r, 2]
                plane = x * normals[r, 0] + y * normals[r, 1] + z * normals[r, 2]
                length = math.sqrt(x * x + y * y + z * z)
                far = min(max((length / plane_mm - 1.0) / 2.0, 0.0), 1.0)
                point = length if inside[i, j, k] else -length
                out[i, j, k] = plane + far * (point - plane)
