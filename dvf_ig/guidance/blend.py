"""Blending two neighbouring phases (Ren 2008, eqs 10 and 11): the readable form of `dvf_ig.kernels.dynamic`.

Eq. 10 as printed, αF(V_i) + (1−α)F(V_{i+1}) with α = (t − t_i)/T_d, gives F(V_{i+1}) at t = t_i
and jumps at every frame switch. The continuous form, used here, is (1−α)F(V_i) + αF(V_{i+1}).
"""

from typing import Literal

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.kernels.fixture_field import BLEND_DISTANCE, BLEND_FORCE, BLEND_PERIODIC
from dvf_ig.kernels.laws import DIRECTION_LOST, DIRECTION_SURE

from .laws import Law

Blend = Literal["force", "distance", "periodic"]
"""`force`: blend two phases' forces (eq. 10, corrected). `distance`: blend d and ∇d, then apply one law.
`periodic`: as `distance`, but d is a cubic periodic spline of phase, without a kink at frame switches."""

BLEND_CODES: dict[Blend, int] = {"force": BLEND_FORCE, "distance": BLEND_DISTANCE, "periodic": BLEND_PERIODIC}


def static_force(law: Law, distance_mm: FloatArray, gradient: FloatArray) -> FloatArray:
    """(n, 3) force of one phase, N: −cap·f(d)·n, faded by smoothstep(|∇d|, 0.2, 0.4) where n is lost.

    Args:
        law: force law.
        distance_mm: (n,) signed distance.
        gradient: (n, 3) its gradient.
    """
    norm = np.linalg.norm(gradient, axis=1)
    t = np.clip((norm - DIRECTION_LOST) / (DIRECTION_SURE - DIRECTION_LOST), 0.0, 1.0)
    push = -law.cap_n * law.potential(distance_mm) * t * t * (3.0 - 2.0 * t)
    return np.asarray(gradient * (push / np.where(norm > 0.0, norm, 1.0))[:, None])


def blend_forces(first_n: FloatArray, second_n: FloatArray, alpha: FloatArray) -> FloatArray:
    """(n, 3) corrected eq. 10: (1−α) F(V_i) + α F(V_{i+1})."""
    weight = np.asarray(alpha)[:, None]
    return np.asarray((1.0 - weight) * first_n + weight * second_n)


def blend_distances(
    law: Law, first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray], alpha: FloatArray
) -> FloatArray:
    """(n, 3) force of the blended field; each phase is ((n,) distance, (n, 3) gradient).

    A blend of distances is not a distance: |∇d| shrinks to cos(θ/2) between normals θ apart, so the law is
    given d/|∇d|.
    """
    weight = np.asarray(alpha)
    distance_mm = (1.0 - weight) * first[0] + weight * second[0]
    return force_of_blend(law, distance_mm, blend_forces(first[1], second[1], weight))


def force_of_blend(law: Law, distance_mm: FloatArray, gradient: FloatArray) -> FloatArray:
    """(n, 3) force of a blended field, (n,) distance and (n, 3) gradient: the law at d/|∇d|."""
    norm = np.linalg.norm(gradient, axis=1)
    return static_force(law, distance_mm / np.where(norm > 0.0, norm, 1.0), gradient)
