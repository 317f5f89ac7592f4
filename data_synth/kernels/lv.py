"""Closed-form motion of the heart about the left ventricle's axis, and its inverse.

Heart frame, mm: apex at z = 0, base (mitral plane) at z = BASE, x towards the right ventricle; a: activation.
In the wall (R_i <= R <= R_o, 0 <= Z <= BASE) the map is exactly incompressible:
    z = Z - a H Z²/L,  g' = 1 - 2aHZ/L,  r² = R²/g' + c(Z),  c = [(1 - κa)² - 1/g'] R_i²,
    θ = Θ + a (-10° (1 - Z/L) + 4° Z/L).
Blood scales with the endocardium, r = R r_i/R_i. Outside the epicardium the wall's motion decays with
exp(-(R - R_o)/ℓ), its longitudinal part more slowly on the right-ventricular side. Above the base the motion
tapers, which stretches the atria in systole.

The epicardium R_o(Z) is the same in all hearts (`heart.warp` gives it its size and shape). The cavity and its
contraction are in a `cavity` array: radius at the base, height of the apex, H, κ, twist at apex and base.
"""

import numpy as np

from dvf_ig.core import AnyArray

from .compiled import kernel
from .interpolation import Point

BASE = 85.0
CAVITY_APEX = 12.0
OUTER = 33.0
INNER = 25.0
POWER = 2.2
H = 0.16
KAPPA = 0.32
TWIST_APEX = np.deg2rad(-10.0)
TWIST_BASE = np.deg2rad(4.0)
STANDARD_CAVITY = np.array([INNER, CAVITY_APEX, H, KAPPA, TWIST_APEX, TWIST_BASE])
"""`cavity` array of the standard heart; angles in rad."""
DECAY = 25.0
RV_EXTRA_DECAY = 35.0
AXIAL_TAPER = 45.0
RADIAL_TAPER = 10.0
OVERSHOOT = 0.5
TOLERANCE2 = 2.5e-5
"""Squared residual, mm², at which the search for an inverse stops."""


@kernel(nogil=True, error_model="numpy")
def outer_radius(z: float) -> float:
    """Compute the epicardial radius at ED height z; constant above the base, zero below the apex."""
    u = min(max(1.0 - z / BASE, 0.0), 1.0)
    return float(OUTER * np.sqrt(1.0 - u**POWER))


@kernel(nogil=True, error_model="numpy")
def radii(z: float, cavity: AnyArray) -> tuple[float, float]:
    """Compute epicardial and endocardial radius at ED height z; constant above the base, 0 below apices."""
    s = min(max(1.0 - (z - cavity[1]) / (BASE - cavity[1]), 0.0), 1.0)
    return outer_radius(z), cavity[0] * np.sqrt(1.0 - s**POWER)


@kernel(nogil=True, error_model="numpy")
def _axial(z: float, cavity: AnyArray) -> tuple[float, float, float, float]:
    """Compute longitudinal shape s(Z), slope for incompressibility, twist (rad) and taper at height Z."""
    if z < 0.0:
        return 0.0, 0.0, cavity[4] * np.exp(-((z / 20.0) ** 2)), 1.0
    if z <= BASE:
        w = z / BASE
        return z * w, 2.0 * w, cavity[4] * (1.0 - w) + cavity[5] * w, 1.0
    u = z - BASE
    taper = np.exp(-((u / RADIAL_TAPER) ** 2))
    rise = 2.0 * OVERSHOOT * (1.0 - np.exp(-u / OVERSHOOT))
    return (BASE + rise) * np.exp(-((u / AXIAL_TAPER) ** 2)), 2.0 * taper, cavity[5] * taper, taper


@kernel(nogil=True, error_model="numpy")
def rv_side(cos_theta: float, z: float) -> float:
    """Compute the degree, 0…1, to which a direction and height belong to the right ventricle's side."""
    if z <= 0.0:
        return 0.0
    lobe = 0.5 * (1.0 + cos_theta)
    lobe = lobe * lobe * (3.0 - 2.0 * lobe)
    rise = min(z / 30.0, 1.0)
    return lobe * rise * rise * (3.0 - 2.0 * rise)


@kernel(nogil=True, error_model="numpy")
def forward_point(x: float, y: float, z: float, a: float, cavity: AnyArray) -> Point:
    """Compute χ_a of one reference point of the heart frame."""
    radius = np.sqrt(x * x + y * y)
    r_out, r_in = radii(z, cavity)
    s, slope, twist, taper = _axial(z, cavity)
    g = 1.0 - a * cavity[2] * slope
    shrink = 1.0 - cavity[3] * a * taper
    c = (shrink * shrink - 1.0 / g) * r_in * r_in
    decay, axial_decay = 1.0, 1.0
    if radius <= r_in:
        r = radius * shrink
    elif radius <= r_out:
        r = np.sqrt(radius * radius / g + c)
    else:
        rho = radius - r_out
        side = rv_side(x / radius, z)
        decay = np.exp(-rho / DECAY)
        axial_decay = np.exp(-rho / (DECAY + RV_EXTRA_DECAY * side))
        wall = (1.0 / g - 1.0) * r_out * r_out + c
        r = np.sqrt(max(radius * radius + wall * decay, 0.0))
    turn = a * twist * decay
    ct, st = np.cos(turn), np.sin(turn)
    scale = r / radius if radius > 1e-12 else (shrink if r_in > 0.0 else 1.0 / np.sqrt(g))
    return scale * (ct * x - st * y), scale * (st * x + ct * y), z - a * cavity[2] * s * axial_decay


@kernel(nogil=True, error_model="numpy")
def _closed_inverse(
    x: float, y: float, z: float, a: float, cavity: AnyArray
) -> tuple[bool, float, float, float]:
    """Find in closed form whether (x, y, z) comes from the left ventricle's wall or blood, and from where."""
    root = 1.0 - 4.0 * a * cavity[2] * z / BASE
    if z < 0.0 or root <= 0.0:
        return False, x, y, z
    height = 2.0 * z / (1.0 + np.sqrt(root))
    if height > BASE:
        return False, x, y, z
    r_out, r_in = radii(height, cavity)
    w = height / BASE
    g = 1.0 - 2.0 * a * cavity[2] * w
    shrink = 1.0 - cavity[3] * a
    squared = x * x + y * y
    if squared <= (shrink * r_in) ** 2:
        scale = 1.0 / shrink
    else:
        original = (squared - (shrink * shrink - 1.0 / g) * r_in * r_in) * g
        if original > r_out * r_out:
            return False, x, y, z
        scale = np.sqrt(original / squared) if squared > 0.0 else np.sqrt(g)
    turn = a * (cavity[4] * (1.0 - w) + cavity[5] * w)
    ct, st = np.cos(turn), np.sin(turn)
    return True, scale * (ct * x + st * y), scale * (ct * y - st * x), height


@kernel(nogil=True, error_model="numpy")
def inverse_point(
    x: float, y: float, z: float, a: float, cavity: AnyArray, gx: float, gy: float, gz: float
) -> Point:
    """Find the reference point that χ_a carries to (x, y, z).

    Closed form in the left ventricle; elsewhere damped Newton from the guess (gx, gy, gz), to 5 µm.
    """
    closed, hx, hy, hz = _closed_inverse(x, y, z, a, cavity)
    if closed:
        return hx, hy, hz
    fx, fy, fz = forward_point(gx, gy, gz, a, cavity)
    ex, ey, ez = x - fx, y - fy, z - fz
    worst = ex * ex + ey * ey + ez * ez
    # χ is close to a shift: plain correction steps settle nearly everywhere and cost one evaluation each
    for _ in range(6):
        if worst < TOLERANCE2:
            return gx, gy, gz
        tx, ty, tz = gx + ex, gy + ey, gz + ez
        fx, fy, fz = forward_point(tx, ty, tz, a, cavity)
        ux, uy, uz = x - fx, y - fy, z - fz
        error = ux * ux + uy * uy + uz * uz
        if error > 0.25 * worst:
            break
        gx, gy, gz, ex, ey, ez, worst = tx, ty, tz, ux, uy, uz, error
    h = 1e-4
    for _ in range(20):
        if worst < TOLERANCE2:
            break
        fx, fy, fz = x - ex, y - ey, z - ez
        ax, ay, az = forward_point(gx + h, gy, gz, a, cavity)
        bx, by, bz = forward_point(gx, gy + h, gz, a, cavity)
        cx, cy, cz = forward_point(gx, gy, gz + h, a, cavity)
        ax, ay, az = (ax - fx) / h, (ay - fy) / h, (az - fz) / h
        bx, by, bz = (bx - fx) / h, (by - fy) / h, (bz - fz) / h
        cx, cy, cz = (cx - fx) / h, (cy - fy) / h, (cz - fz) / h
        det = ax * (by * cz - bz * cy) - bx * (ay * cz - az * cy) + cx * (ay * bz - az * by)
        dx = (ex * (by * cz - bz * cy) - bx * (ey * cz - ez * cy) + cx * (ey * bz - ez * by)) / det
        dy = (ax * (ey * cz - ez * cy) - ex * (ay * cz - az * cy) + cx * (ay * ez - az * ey)) / det
        dz = (ax * (by * ez - bz * ey) - bx * (ay * ez - az * ey) + ex * (ay * bz - az * by)) / det
        step = 1.0
        for _ in range(6):
            tx, ty, tz = gx + step * dx, gy + step * dy, gz + step * dz
            fx, fy, fz = forward_point(tx, ty, tz, a, cavity)
            ux, uy, uz = x - fx, y - fy, z - fz
            error = ux * ux + uy * uy + uz * uz
            if error < worst:
                break
            step *= 0.5
        gx, gy, gz, ex, ey, ez, worst = tx, ty, tz, ux, uy, uz, error
    return gx, gy, gz
