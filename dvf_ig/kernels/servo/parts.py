"""Share of each fixture in the composed force, and velocity of its surface, for the energy that it gives."""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import inlined
from dvf_ig.kernels.place import Columns, Phase
from dvf_ig.kernels.pose_and_phase import distance_rate
from dvf_ig.kernels.vectors import Vector, dot


@inlined
def to_tracker(pose: Columns, v: Vector) -> Vector:
    """A free vector of the model's frame in the tracker's."""
    return dot(pose[0], v), dot(pose[1], v), dot(pose[2], v)


@inlined
def note_field(fields: FloatArray, i: int, gradient: Vector, rate: float) -> None:
    """Keep gradient and rate of fixture `i`, whose surface moves by itself; 0 if it is out of reach."""
    finite = math.isfinite(gradient[0] + gradient[1] + gradient[2] + rate)
    for k in range(3):
        fields[i, k] = gradient[k] if finite else 0.0
    fields[i, 3] = rate if finite else 0.0


@inlined
def note_parts(bound: Any, scratch: Any, pose: Columns, phase: Phase, xyz: FloatArray) -> int:
    """Write each fixture's share of the composed force and its surface's velocity, tracker frame; count.

    Forbidden regions were shortened equally; what composition left of the guidance is shared out by size.
    """
    of, composed, forces, count = (
        bound.settings[0].fixtures,
        scratch.composed[0],
        scratch.forces,
        len(bound.packed),
    )
    pushed = guided = before = 0.0
    for i in range(count):
        size = 0.0
        for k in range(3):
            size += forces[i, k] * forces[i, k]
        if of.forbidden[i] == 0.0:
            guided += math.sqrt(size)
    for k in range(3):
        total = 0.0
        for i in range(count):
            total += forces[i, k] if of.forbidden[i] != 0.0 else 0.0
        before += total * total
        pushed += total * composed.forbidden_n[k]
    remaining = pushed / before if before > 0.0 else 0.0
    for i in range(count):
        field = (scratch.fields[i, 0], scratch.fields[i, 1], scratch.fields[i, 2])
        square = dot(field, field)
        per = 0.0
        if square > 0.0:
            per = -distance_rate(pose, phase, xyz, field, scratch.fields[i, 3]) / square
        turned = to_tracker(pose, field)
        share = remaining
        if of.forbidden[i] == 0.0:
            size = math.sqrt(forces[i, 0] ** 2 + forces[i, 1] ** 2 + forces[i, 2] ** 2)
            share = size / guided if guided > 0.0 else 0.0
        for k in range(3):
            scratch.part_mm_s[i, k] = per * turned[k]
            part = forces[i, k] if of.forbidden[i] != 0.0 else composed.guidance_n[k]
            scratch.part_n[i, k] = share * part
    return count
