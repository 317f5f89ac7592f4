"""Motion on a grid with knots over the cycle, and its inverse: trilinear in space, linear between knots."""

from dvf_ig.core import AnyArray

from .compiled import kernel
from .interpolation import Point, cell


@kernel(nogil=True, error_model="numpy")
def reference_point(
    x: float,
    y: float,
    z: float,
    displacement: AnyArray,
    origin: AnyArray,
    inverse_spacing: float,
    first: int,
    second: int,
    weight: float,
) -> Point:
    """Compute X = χ⁻¹(x) by linear interpolation in space and between two knots."""
    nx, ny, nz = displacement.shape[1], displacement.shape[2], displacement.shape[3]
    i, fx = cell((x - origin[0]) * inverse_spacing, nx)
    j, fy = cell((y - origin[1]) * inverse_spacing, ny)
    k, fz = cell((z - origin[2]) * inverse_spacing, nz)
    dx, dy, dz = 0.0, 0.0, 0.0
    for knot in range(2):
        n = first if knot == 0 else second
        share = 1.0 - weight if knot == 0 else weight
        if share == 0.0:
            continue
        for a in range(2):
            wa = share * (fx if a else 1.0 - fx)
            for b in range(2):
                wb = wa * (fy if b else 1.0 - fy)
                low = wb * (1.0 - fz)
                high = wb * fz
                near = displacement[n, i + a, j + b, k]
                far = displacement[n, i + a, j + b, k + 1]
                dx += low * near[0] + high * far[0]
                dy += low * near[1] + high * far[1]
                dz += low * near[2] + high * far[2]
    return x + dx, y + dy, z + dz


@kernel(nogil=True, error_model="numpy")
def pull_back(
    points: AnyArray,
    displacement: AnyArray,
    origin: AnyArray,
    inverse_spacing: float,
    first: AnyArray,
    second: AnyArray,
    weight: AnyArray,
    out: AnyArray,
) -> None:
    """Compute reference positions of (n, 3) points, each at its own pair of knots (n,)."""
    for i in range(len(points)):
        out[i, 0], out[i, 1], out[i, 2] = reference_point(
            points[i, 0],
            points[i, 1],
            points[i, 2],
            displacement,
            origin,
            inverse_spacing,
            first[i],
            second[i],
            weight[i],
        )


@kernel(nogil=True, error_model="numpy")
def polish(
    points: AnyArray,
    forward: AnyArray,
    origin: AnyArray,
    inverse_spacing: float,
    first: AnyArray,
    second: AnyArray,
    weight: AnyArray,
    out: AnyArray,
) -> None:
    """Improve `out`, guesses of X with X + u(X) = x, to 1e-4 mm; u trilinear, each point at its own knots."""
    for i in range(len(points)):
        gx, gy, gz = out[i, 0], out[i, 1], out[i, 2]
        best, damping = 1e18, 1.0
        bx, by, bz, ex, ey, ez = gx, gy, gz, 0.0, 0.0, 0.0
        for _ in range(80):
            fx, fy, fz = reference_point(
                gx, gy, gz, forward, origin, inverse_spacing, first[i], second[i], weight[i]
            )
            rx, ry, rz = points[i, 0] - fx, points[i, 1] - fy, points[i, 2] - fz
            error = rx * rx + ry * ry + rz * rz
            if error < best:
                best, bx, by, bz, ex, ey, ez = error, gx, gy, gz, rx, ry, rz
                if error < 1e-8:
                    break
            else:
                damping *= 0.6
            gx, gy, gz = bx + damping * ex, by + damping * ey, bz + damping * ez
        out[i, 0], out[i, 1], out[i, 2] = bx, by, bz
