"""Passivity observer and controller of a moving fixture, on the force that was really sent.

Between two ticks the device held a force F that had been sent (`delay_ticks` ticks ago, where the device is
late) while the tool moved by Δx and the fixture's surface, where the tool is, by Δs. The work given to the
hand, F·Δx, has two parts: F·Δs, by which a moving surface takes the tool with it, known and wanted; and
F·(Δx − Δs), the work relative to the surface. A fixture in continuous time would have done
½(F_k + F_{k−1})·(Δx − Δs) there, F_k its force at each place: what it stores it gives back. The difference

    r = [F − ½(F_k + F_{k−1})]·(Δx − Δs)

is energy that holding, latency and quantisation have made. Its sum, less what was taken back, is the
residual. The controller adds a damping force −b(v − v_s) with b chosen so that the residual is gone after one
period, but never more than `largest damping`. A negative residual gives no credit.

Source: Hannaford and Ryu 2002 (observer and controller in the time domain); Ryu et al. 2005 (following a
reference energy); surface motion and the trapezoid as the reference are this project's.

With several structures F is a sum of parts F_i, each with the velocity v_i of its own surface: F·Δs becomes
Σ F_i·v_i Δt, and what was sent beyond its parts, such as damping, counts with their mean velocity by force.
"""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import inlined

from .layout import MAX_FIXTURES, SENT_KEPT


@inlined
def observe(
    p: Any,
    xyz: FloatArray,
    field: FloatArray,
    dt_s: float,
    delay_ticks: int,
    following: bool,
    parts: int,
    part_n: FloatArray,
    part_mm_s: FloatArray,
) -> None:
    """Account for the period that has just passed; fills the energies of the memory.

    Args:
        p: PASSIVITY; all zero before the first tick.
        xyz: (3,) measured position, mm.
        field: (3,) N, the fixtures' force there, before damping and supervision.
        dt_s: since the last tick.
        delay_ticks: ticks between sending a force and feeling it, beyond the period in which it is sent.
        following: the supervisor sends what is wanted; while it fades or limits, the residual is kept.
        parts: fixtures with a share of the field of their own; 0: the whole field moves with one surface.
        part_n, part_mm_s: (k, 3) their shares, and the velocities of their surfaces now.
    """
    if p.started != 0:
        back = p.sent_count - 1 - min(delay_ticks, SENT_KEPT - 1)
        to_hand = by_surface = excess = 0.0
        for k in range(3):
            sent = p.sent_n[back % SENT_KEPT, k] if back >= 0 else 0.0
            moved = xyz[k] - p.last_xyz_mm[k]
            surface = p.surface_mm_s[k] * dt_s
            to_hand += sent * moved
            by_surface += sent * surface
            excess += (sent - 0.5 * (field[k] + p.last_field_n[k])) * (moved - surface)
        if p.parts != 0:
            by_parts, allowed = _by_parts(p, back, dt_s, parts, part_n)
            for k in range(3):
                allowed -= 0.5 * (field[k] + p.last_field_n[k]) * p.surface_mm_s[k] * dt_s
            excess += by_surface - by_parts + allowed
            by_surface = by_parts
        p.given_mj += to_hand
        p.by_surface_mj += by_surface
        if following:
            p.residual_mj = max(0.0, p.residual_mj + excess)
    p.started = 1
    for k in range(3):
        p.last_xyz_mm[k], p.last_field_n[k] = xyz[k], field[k]
    p.parts = parts
    for i in range(parts):
        p.parted = 1
        for k in range(3):
            p.part_n[i, k], p.part_mm_s[i, k] = part_n[i, k], part_mm_s[i, k]


@inlined
def _by_parts(p: Any, back: int, dt_s: float, parts: int, part_n: FloatArray) -> tuple[float, float]:
    """Work of the surfaces by the force sent `back`, and what they would have done in continuous time."""
    by_parts = allowed = 0.0
    for k in range(3):
        rest = p.sent_n[back % SENT_KEPT, k] if back >= 0 else 0.0
        for i in range(p.parts):
            sent = p.sent_part_n[back % SENT_KEPT, i, k] if back >= 0 else 0.0
            rest -= sent
            by_parts += sent * p.part_mm_s[i, k] * dt_s
            now = part_n[i, k] if i < parts else p.part_n[i, k]
            allowed += 0.5 * (now + p.part_n[i, k]) * p.part_mm_s[i, k] * dt_s
        by_parts += rest * p.surface_mm_s[k] * dt_s
    return by_parts, allowed


@inlined
def mean_velocity(parts: int, part_n: FloatArray, part_mm_s: FloatArray, out: FloatArray) -> None:
    """Write the surfaces' mean velocity by the sizes of their forces to `out` (3,), if there is any."""
    total = 0.0
    x = y = z = 0.0
    for i in range(parts):
        size = math.sqrt(part_n[i, 0] ** 2 + part_n[i, 1] ** 2 + part_n[i, 2] ** 2)
        total += size
        x, y, z = x + size * part_mm_s[i, 0], y + size * part_mm_s[i, 1], z + size * part_mm_s[i, 2]
    if total > 0.0:
        out[0], out[1], out[2] = x / total, y / total, z / total


@inlined
def control(
    p: Any, speed: FloatArray, surface_speed: FloatArray, dt_s: float, largest: float, out: FloatArray
) -> None:
    """Add the controller's damping force to `out` (3,) N, and remember the surface's speed for `observe`.

    Args:
        speed, surface_speed: (3,) mm/s of tool and surface.
        dt_s: period in which the force will act.
        largest: largest damping, N·s/mm; 0 switches the controller off.
    """
    square = 0.0
    for k in range(3):
        p.surface_mm_s[k] = surface_speed[k]
        square += (speed[k] - surface_speed[k]) ** 2
    p.damping = 0.0
    if largest <= 0.0 or p.residual_mj <= 0.0 or square <= 0.0:
        return
    damping = min(largest, p.residual_mj / (square * dt_s))
    p.damping = damping
    for k in range(3):
        out[k] -= damping * (speed[k] - surface_speed[k])


@inlined
def note_sent(p: Any, sent: FloatArray) -> None:
    """Remember a force that was sent, (3,) N."""
    at = p.sent_count % SENT_KEPT
    for k in range(3):
        p.sent_n[at, k] = sent[k]
    if p.parted != 0:
        for i in range(MAX_FIXTURES):
            for k in range(3):
                p.sent_part_n[at, i, k] = p.part_n[i, k] if i < p.parts else 0.0
    p.sent_count += 1
