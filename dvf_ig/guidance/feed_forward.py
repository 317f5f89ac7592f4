"""Feed-forward of the surface's motion: damping relative to it, and compensation of dry friction along it."""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.kernels.laws import direction_certainty

MM_PER_M = 1000.0


@dataclass(frozen=True, slots=True)
class FeedForward:
    """−B((v·n) − v_n)n + c·tanh(v_n/v₀)·n, n = ∇d/|∇d|, v_n = −(∂d/∂t)/|∇d| the surface's speed along n.

    The first term damps the tool relative to the surface instead of the room. The second compensates dry
    friction while the tool moves with the surface. Its power is at most c·|v|, so a device whose own dry
    friction is at least c stays passive; `SimulatedDevice.limits` uses the remaining friction.

    Attributes:
        damping_n_s_per_m: B.
        friction_n: c, at most the smallest dry friction of the device.
        slow_mm_s: v₀, below which the compensation is reduced, so that it does not jump where the surface
            reverses.
    """

    damping_n_s_per_m: float = 0.0
    friction_n: float = 0.0
    slow_mm_s: float = 2.0

    def __post_init__(self) -> None:
        for name in ("damping_n_s_per_m", "friction_n"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidInputError(
                    f"feed-forward {name} is {value:g}; it must be finite and not negative"
                )
        if not (math.isfinite(self.slow_mm_s) and self.slow_mm_s > 0.0):
            raise InvalidInputError(f"feed-forward slow_mm_s is {self.slow_mm_s:g}; it must be positive")

    def force(self, gradient: FloatArray, distance_rate_mm_s: float, velocity_mm_s: FloatArray) -> FloatArray:
        """(3,) N to add to the fixture's force, faded like it where the direction is uncertain.

        Args:
            gradient: (3,) ∇d at the tool.
            distance_rate_mm_s: ∂d/∂t at the fixed position of the tool.
            velocity_mm_s: (3,) of the tool, same frame; used by the damping alone.
        """
        norm = float(np.linalg.norm(gradient))
        certainty = direction_certainty(norm)
        if certainty == 0.0:
            return np.zeros(3)
        normal = gradient / norm
        surface = -distance_rate_mm_s / norm
        push = self.friction_n * math.tanh(surface / self.slow_mm_s)
        if self.damping_n_s_per_m > 0.0:
            push -= self.damping_n_s_per_m / MM_PER_M * (float(velocity_mm_s @ normal) - surface)
        return np.asarray(certainty * push * normal)


NO_FEED_FORWARD = FeedForward()
"""No term is added."""
