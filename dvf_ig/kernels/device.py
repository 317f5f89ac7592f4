"""Motion of a mass with viscous and dry friction under a force held for one servo period.

Each sub-step is semi-implicit: applied force and viscous friction give a velocity implicitly, dry friction
reduces the speed by at most its impulse (so a mass at rest stays at rest exactly), then the position follows
the new velocity. Friction so computed removes energy at any sub-step.
"""

import math

from dvf_ig.core import FloatArray

from .compiled import kernel

MM_PER_M = 1000.0


@kernel
def advance(
    state: FloatArray,
    force_n: FloatArray,
    mass_kg: float,
    viscous_n_s_per_m: float,
    dry_n: float,
    largest_n: float,
    period_s: float,
    steps: int,
    out: FloatArray,
) -> None:
    """Advance the state by one servo period.

    Args:
        state: (6,) position in mm, velocity in mm/s.
        force_n: (3,) commanded force; limited to `largest_n`; zero if not finite.
        mass_kg, viscous_n_s_per_m, dry_n: mass and friction of the moving parts.
        period_s: time the force is held, in `steps` equal sub-steps.
        out: (6,) state afterwards; may be `state` itself.
    """
    fx, fy, fz = force_n[0], force_n[1], force_n[2]
    length = math.sqrt(fx * fx + fy * fy + fz * fz)
    share = min(1.0, largest_n / length) if length > 0.0 else 1.0
    if not math.isfinite(length):
        fx, fy, fz, share = 0.0, 0.0, 0.0, 0.0
    h = period_s / steps
    push = h * MM_PER_M * share / mass_kg
    slowed = 1.0 / (1.0 + h * viscous_n_s_per_m / mass_kg)
    dry = h * MM_PER_M * dry_n / mass_kg * slowed
    x, y, z, vx, vy, vz = state[0], state[1], state[2], state[3], state[4], state[5]
    for _ in range(steps):
        vx, vy, vz = (vx + push * fx) * slowed, (vy + push * fy) * slowed, (vz + push * fz) * slowed
        speed = math.sqrt(vx * vx + vy * vy + vz * vz)
        share = 1.0 - dry / speed if speed > dry else 0.0
        vx, vy, vz = share * vx, share * vy, share * vz
        x, y, z = x + h * vx, y + h * vy, z + h * vz
    out[0], out[1], out[2], out[3], out[4], out[5] = x, y, z, vx, vy, vz
