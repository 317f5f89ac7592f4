"""The force of several fixtures together, and the stiffness of those that share the organ's surface."""

import dataclasses

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError

from .blend import static_force
from .composition import Composed, Contribution, compose
from .device import MM_PER_M
from .fixture import FixtureSet
from .laws import Gaussian, Law

REACH_WIDTHS = 4.0
SAMPLES = 401
"""The joint force is sampled so far about each law's depth, in widths δ or 1/γ, and at so many distances."""


def composed_force(options: FixtureSet, forces_n: FloatArray) -> Composed:
    """All forces (k, 3) in one, k fixtures in the order of the set."""
    forbidden: list[Contribution] = []
    guidance: list[Contribution] = []
    for one, force_n in zip(options.fixtures, forces_n, strict=True):
        part = Contribution("query", force_n, one.law.cap_n)
        (forbidden if one.forbidden else guidance).append(part)
    return compose(forbidden, guidance, frame="query", cap_n=options.joint_cap_n)


def force_at_distance(options: FixtureSet, distance_mm: FloatArray, normal: FloatArray) -> FloatArray | None:
    """(n, 3) force where distance and direction are known otherwise, for example from ground truth.

    Args:
        distance_mm: (n,) signed distance to the organ's surface.
        normal: (n, 3) its unit gradient.
    Returns:
        the force in the frame of `normal`; None for a set with a path, whose distance this is not.
    """
    if any(one.path is not None for one in options.fixtures):
        return None
    each = np.stack([static_force(one.law, distance_mm, normal) for one in options.fixtures], axis=1)
    if not options.composed:
        return np.asarray(each[:, 0])
    return np.array([composed_force(options, forces).force_n for forces in each]).reshape(-1, 3)


def check_joint_stiffness(options: FixtureSet) -> None:
    """Hold the fixtures on the surface, composed, to their device's stiffness along the normal.

    Secants of the force over distance: they never exceed the steepest slope, and miss little of it.

    Raises:
        InvalidInputError: together they are stiffer than the device renders.
    """
    on_surface = tuple(one for one in options.fixtures if one.path is None)
    if len(on_surface) < 2:
        return
    # whole µm: over less, rounding of the force would count as slope
    distance_mm = np.unique(np.concatenate([_about_depth(one.law) for one in on_surface]).round(3))
    normal = np.tile([1.0, 0.0, 0.0], (len(distance_mm), 1))
    force_n = force_at_distance(dataclasses.replace(options, fixtures=on_surface), distance_mm, normal)
    if force_n is None:
        return
    slope = np.abs(np.diff(force_n[:, 0])) / np.diff(distance_mm)
    steepest = int(slope.argmax())
    allowed = options.device.allowed_stiffness_n_per_mm
    if slope[steepest] > allowed * (1.0 + 1e-6):
        raise InvalidInputError(
            f"the fixtures together are too stiff for the device: {slope[steepest] * MM_PER_M:.4g} N/m "
            f"{distance_mm[steepest]:.2g} mm below the surface, at most {allowed * MM_PER_M:.4g} N/m "
            "allowed; lower a cap, make a law less steep, or set their depths apart"
        )


def _about_depth(law: Law) -> FloatArray:
    """(SAMPLES,) distances about the depth that a law guards."""
    width_mm = law.delta_mm if isinstance(law, Gaussian) else 1.0 / law.gamma_per_mm
    # a confinement's depth is in the wall, outside the surface
    depth_mm = float(law.parameters[4])
    half_mm = REACH_WIDTHS * width_mm
    return np.linspace(depth_mm - half_mm, depth_mm + half_mm, SAMPLES)
