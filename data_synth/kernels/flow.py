"""Smooth part of the heart's motion: the flow of a steady velocity field outside the left ventricle.

Heart frame, mm; "time" is the activation a. The field vanishes inside the left ventricle, so that composing
its flow with `lv.forward_point` leaves the closed form there untouched:
    χ_a = LV_a ∘ Ψ_a,   χ_a⁻¹ = Ψ_{−a} ∘ LV_a⁻¹.
The right ventricle moves towards the septum; each atrium swells about its centre, above the valve plane.
"""

import numpy as np

from dvf_ig.core import AnyArray

from .compiled import kernel
from .interpolation import Point
from .lv import BASE, outer_radius

STEPS = 2
SEPTUM_MM = 14.0
"""Distance outside the left ventricle over which the right ventricle's part rises from 0 to its full size."""
APEX_MM = 20.0
"""Height above the pointed apex over which it rises; a steeper field would fold there."""
RV_ABOVE = 12.0
"""Half the height about the valve plane over which the right ventricle's part fades."""
ATRIUM_ONSET = 22.0


@kernel(nogil=True, error_model="numpy", inline="always")
def smooth_step(u: float) -> float:
    """Compute a twice differentiable step: 0 below 0, 1 above 1."""
    t = min(max(u, 0.0), 1.0)
    return t * t * t * (10.0 + t * (6.0 * t - 15.0))


@kernel(nogil=True, error_model="numpy", inline="always")
def _lobe(dx: float, dy: float, dz: float, lobe: AnyArray) -> float:
    """Compute the rate of swelling (1 − d²)³ inside an ellipsoid; its divergence changes sign at d = 1/√3."""
    d2 = (dx * lobe[3]) ** 2 + (dy * lobe[4]) ** 2 + (dz * lobe[5]) ** 2
    if d2 >= 1.0:
        return 0.0
    rest = 1.0 - d2
    return float(lobe[6] * rest * rest * rest)


@kernel(nogil=True, error_model="numpy")
def velocity(x: float, y: float, z: float, lobes: AnyArray) -> Point:
    """Compute the displacement per unit of activation at one point.

    Args:
        lobes: (3, 7) centre, reciprocal semi-axes and rate of right ventricle, left and right atrium.
    """
    vx, vy, vz = 0.0, 0.0, 0.0
    if 0.0 < z < BASE + RV_ABOVE:
        dx, dy, dz = x - lobes[0, 0], y - lobes[0, 1], z - lobes[0, 2]
        rate = _lobe(dx, dy, dz, lobes[0])
        if rate != 0.0:
            rho = np.sqrt(x * x + y * y) - outer_radius(z)
            if rho > 0.0:
                rate *= smooth_step(rho / SEPTUM_MM) * smooth_step(z / APEX_MM)
                rate *= smooth_step((BASE + RV_ABOVE - z) / (2.0 * RV_ABOVE))
                vx, vy, vz = rate * dx, rate * dy, rate * dz
    if z > BASE:
        above = smooth_step((z - BASE) / ATRIUM_ONSET)
        for n in range(1, len(lobes)):
            dx, dy, dz = x - lobes[n, 0], y - lobes[n, 1], z - lobes[n, 2]
            rate = above * _lobe(dx, dy, dz, lobes[n])
            vx += rate * dx
            vy += rate * dy
            vz += rate * dz
    return vx, vy, vz


@kernel(nogil=True, error_model="numpy")
def flow_point(x: float, y: float, z: float, a: float, lobes: AnyArray) -> Point:
    """Compute Ψ_a of one point by fourth-order Runge-Kutta; Ψ_{−a} is its inverse."""
    h = a / STEPS
    for _ in range(STEPS):
        ax, ay, az = velocity(x, y, z, lobes)
        if ax == 0.0 and ay == 0.0 and az == 0.0:
            # a resting point of a steady field does not move
            return x, y, z
        bx, by, bz = velocity(x + 0.5 * h * ax, y + 0.5 * h * ay, z + 0.5 * h * az, lobes)
        cx, cy, cz = velocity(x + 0.5 * h * bx, y + 0.5 * h * by, z + 0.5 * h * bz, lobes)
        dx, dy, dz = velocity(x + h * cx, y + h * cy, z + h * cz, lobes)
        x += h * (ax + 2.0 * bx + 2.0 * cx + dx) / 6.0
        y += h * (ay + 2.0 * by + 2.0 * cy + dy) / 6.0
        z += h * (az + 2.0 * bz + 2.0 * cz + dz) / 6.0
    return x, y, z
