"""Motion χ_a of the whole heart in frame "mr", and its inverse behind a mismatch, for many points."""

from dvf_ig.core import AnyArray

from .compiled import kernel
from .flow import flow_point
from .interpolation import Point, cubic_point
from .lv import forward_point, inverse_point

STILL_STEPS = 12
STILL_TOLERANCE = 1e-4
"""Change of the activation at which the search for a still region's own one stops: some 2 µm of motion."""


@kernel(nogil=True, error_model="numpy", inline="always")
def _turned(x: float, y: float, z: float, rotation: AnyArray) -> Point:
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@kernel(nogil=True, error_model="numpy")
def forward(
    points: AnyArray,
    levels: AnyArray,
    rotation: AnyArray,
    translation: AnyArray,
    lobes: AnyArray,
    cavity: AnyArray,
    out: AnyArray,
) -> None:
    """Compute χ of (n, 3) points at (n,) activations into `out`; `rotation`, `translation`: mr_from_heart."""
    back = rotation.T
    for i in range(len(points)):
        x, y, z = _turned(
            points[i, 0] - translation[0], points[i, 1] - translation[1], points[i, 2] - translation[2], back
        )
        x, y, z = flow_point(x, y, z, levels[i], lobes)
        x, y, z = forward_point(x, y, z, levels[i], cavity)
        x, y, z = _turned(x, y, z, rotation)
        out[i, 0], out[i, 1], out[i, 2] = x + translation[0], y + translation[1], z + translation[2]


@kernel(nogil=True, error_model="numpy")
def _moving_share(x: float, y: float, z: float, still: AnyArray) -> float:
    """Compute the factor on the activation of a reference point in the heart frame."""
    dx, dy, dz = x - still[0], y - still[1], z - still[2]
    near = max(1.0 - (dx * dx + dy * dy + dz * dz) / (still[3] * still[3]), 0.0)
    return float(1.0 - near * near * near)


@kernel(nogil=True, error_model="numpy")
def _with_still_region(
    x: float,
    y: float,
    z: float,
    level: float,
    moving: Point,
    lobes: AnyArray,
    cavity: AnyArray,
    still: AnyArray,
) -> Point:
    """Find the reference point of (x, y, z) at its own activation, by secants in that activation.

    Args:
        level: activation outside the still region.
        moving: reference point at that activation.
    """
    u, v, w = moving
    before, excess_before = level, level - level * _moving_share(u, v, w, still)
    own = level - excess_before
    for _ in range(STILL_STEPS):
        if abs(own - before) < STILL_TOLERANCE:
            break
        a, b, c = inverse_point(x, y, z, own, cavity, u, v, w)
        u, v, w = flow_point(a, b, c, -own, lobes)
        excess = own - level * _moving_share(u, v, w, still)
        step = excess * (own - before) / (excess - excess_before) if excess != excess_before else 0.0
        before, excess_before, own = own, excess, own - step
    return u, v, w


@kernel(nogil=True, error_model="numpy")
def inverse(
    points: AnyArray,
    levels: AnyArray,
    rotation: AnyArray,
    translation: AnyArray,
    lobes: AnyArray,
    cavity: AnyArray,
    mismatch: AnyArray,
    mismatch_origin: AnyArray,
    mismatch_inverse_spacing: float,
    still: AnyArray,
    out: AnyArray,
) -> None:
    """Compute χ⁻¹ after the inverse mismatch of (n, 3) points at (n,) activations into `out`.

    Consecutive points should be neighbours: each displacement starts the search of the next.

    Args:
        mismatch: (nx, ny, nz, 3) displacement of the inverse mismatch, cubic between nodes; empty: none.
        still: (4,) middle of the still region in the heart frame and its radius; radius 0: none.
    """
    back = rotation.T
    ex, ey, ez, last = 0.0, 0.0, 0.0, 0.0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if mismatch.shape[0] > 0:
            dx, dy, dz = cubic_point(x, y, z, mismatch, mismatch_origin, mismatch_inverse_spacing)
            x, y, z = x + dx, y + dy, z + dz
        x, y, z = _turned(x - translation[0], y - translation[1], z - translation[2], back)
        level = levels[i]
        ratio = level / last if last > 0.05 else 0.0
        u, v, w = inverse_point(x, y, z, level, cavity, x + ratio * ex, y + ratio * ey, z + ratio * ez)
        ex, ey, ez, last = u - x, v - y, w - z, level
        u, v, w = flow_point(u, v, w, -level, lobes)
        if still[3] > 0.0:
            u, v, w = _with_still_region(x, y, z, level, (u, v, w), lobes, cavity, still)
        u, v, w = _turned(u, v, w, rotation)
        out[i, 0], out[i, 1], out[i, 2] = u + translation[0], v + translation[1], w + translation[2]
