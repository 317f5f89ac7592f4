"""What a haptic device can render without adding energy; fixtures beyond it are refused."""

import math
from dataclasses import dataclass
from typing import TypeVar

from dvf_ig.core import InvalidInputError

from .laws import Gaussian, Law, Sigmoid

L = TypeVar("L", bound=Sigmoid | Gaussian)


@dataclass(frozen=True, slots=True)
class DeviceLimits:
    """Bounds of one device.

    Attributes:
        rate_hz: servo rate 1/T.
        stiffness_n_per_m: largest stiffness that the device renders (theory: fixtures, 400 N/m).
        damping_n_s_per_m: physical damping b of device and hand; None where it is unknown, and then the
            passivity bound is not checked.
        virtual_damping_n_s_per_m: damping B that the controller adds.
    """

    rate_hz: float = 1000.0
    stiffness_n_per_m: float = 400.0
    damping_n_s_per_m: float | None = None
    virtual_damping_n_s_per_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rate_hz", "stiffness_n_per_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidInputError(f"device limit {name} is {value:g}; it must be positive and finite")
        if not math.isfinite(self.virtual_damping_n_s_per_m):
            raise InvalidInputError("device limit virtual_damping_n_s_per_m must be finite")

    @property
    def passive_stiffness_n_per_mm(self) -> float:
        """Colgate–Schenkel: b > KT/2 + |B| gives K < 2(b − |B|)/T; infinite where b is unknown."""
        if self.damping_n_s_per_m is None:
            return math.inf
        spare = self.damping_n_s_per_m - abs(self.virtual_damping_n_s_per_m)
        return 2.0 * max(spare, 0.0) * self.rate_hz / 1000.0

    def checked(self, law: L) -> L:
        """The law itself, if this device can render it.

        Raises:
            InvalidInputError: its steepest point exceeds the stiffness cap or the passivity bound.
        """
        allowed = min(self.stiffness_n_per_m / 1000.0, self.passive_stiffness_n_per_mm)
        stiffness = law.stiffness_n_per_mm
        if stiffness <= allowed:
            return law
        passive = self.passive_stiffness_n_per_mm < self.stiffness_n_per_m / 1000.0
        reason = "passivity at its sampling rate" if passive else "its stiffness cap"
        raise InvalidInputError(
            f"the fixture is too stiff for the device: {stiffness * 1000:.4g} N/m at its steepest, "
            f"at most {allowed * 1000:.4g} N/m allowed by {reason}; {_remedy(law, allowed)}"
        )


COMMON_DEVICE = DeviceLimits()
"""1 kHz and 400 N/m: what is assumed of a device of which nothing else is known."""


def _remedy(law: Law, allowed_n_per_mm: float) -> str:
    """What to change so that the law fits: γ ≤ 4K/F, δ ≥ c_m F/K."""
    if allowed_n_per_mm <= 0.0:
        return "lower the virtual damping"
    if isinstance(law, Sigmoid):
        return f"use gamma_per_mm <= {4.0 * allowed_n_per_mm / law.cap_n:.4g} or a lower cap"
    if law.m < 0.5:
        return "use m >= 0.5 (below it the stiffness at the target is unbounded)"
    return f"use delta_mm >= {law.delta_mm * law.stiffness_n_per_mm / allowed_n_per_mm:.4g} or a lower cap"
