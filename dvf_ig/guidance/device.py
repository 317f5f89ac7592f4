"""Limits of a haptic device: its force, its stiffness, the passivity bound; what exceeds them is refused."""

import math
from dataclasses import dataclass
from typing import TypeVar

from dvf_ig.core import InvalidInputError

from .laws import Gaussian, Law, gaussian_steepness, require_force

L = TypeVar("L", bound=Law)

MM_PER_M = 1000.0
UNNAMED_FORCE_N = 4.0
"""Largest continuous force where no device is named. By judgement: Ren 2008 uses 0.6 N, and the styluses of
`dvf_ig.guidance.devices.simulated` hold 0.88 and 1.4 N."""


@dataclass(frozen=True, slots=True)
class DeviceLimits:
    """Bounds of one device.

    Passivity, per servo period T in which the tip moves by x = vT: holding a spring's force gives up to ½Kx²,
    reading its position to a step Δ another ½KΔx; viscous friction takes at least (b − |B|)x²/T, dry friction
    c·x. So K <= 2((b − |B|)v + c)/(vT + Δ) at every speed v up to the fastest. Where no friction and no
    resolution are given this is the bound of Colgate and Schenkel (b > KT/2 + |B|); at unlimited speed it is
    that of Abbott and Okamura, min(2b/T, 2c/Δ).

    Attributes:
        rate_hz: servo rate 1/T.
        stiffness_n_per_m: largest stiffness that the device renders (400 N/m: see
            docs/theory/fixtures.md).
        damping_n_s_per_m: physical damping b of device and hand; None if unknown, and then the
            passivity bound is not checked.
        virtual_damping_n_s_per_m: damping B that the controller adds.
        friction_n: smallest dry friction c; 0 assumes none.
        resolution_mm: step Δ of the position sensor.
        fastest_mm_s: largest speed of the tip for which the bound holds.
        continuous_force_n: largest force that the device holds for long; more than 4 N needs its name.
        name: of the device; empty: none in particular.
    Raises:
        InvalidInputError: a number that is negative, not finite or beyond any device, or a force above 4 N
            of a device without a name.
    Source: Colgate and Schenkel 1997; Abbott and Okamura 2005 (IEEE Trans. Robotics 21(5)).
    """

    rate_hz: float = 1000.0
    stiffness_n_per_m: float = 400.0
    damping_n_s_per_m: float | None = None
    virtual_damping_n_s_per_m: float = 0.0
    friction_n: float = 0.0
    resolution_mm: float = 0.0
    fastest_mm_s: float = math.inf
    continuous_force_n: float = UNNAMED_FORCE_N
    name: str = ""

    def __post_init__(self) -> None:
        for name in ("rate_hz", "stiffness_n_per_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidInputError(f"device limit {name} is {value:g}; it must be positive and finite")
        for name in ("damping_n_s_per_m", "friction_n", "resolution_mm"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0.0):
                raise InvalidInputError(
                    f"device limit {name} is {value:g}; it must be finite and not negative"
                )
        if not math.isfinite(self.virtual_damping_n_s_per_m):
            raise InvalidInputError("device limit virtual_damping_n_s_per_m must be finite")
        if not self.fastest_mm_s > 0.0:
            raise InvalidInputError(
                f"device limit fastest_mm_s is {self.fastest_mm_s:g}; it must be positive"
            )
        require_force("device limit continuous_force_n", self.continuous_force_n)
        if self.continuous_force_n > UNNAMED_FORCE_N and not self.name.strip():
            raise InvalidInputError(
                f"device limit continuous_force_n is {self.continuous_force_n:g} N; more than "
                f"{UNNAMED_FORCE_N:g} N needs the name of the device"
            )

    @property
    def passive_stiffness_n_per_mm(self) -> float:
        """Stiffness of the stiffest passive spring; infinite if b is unknown, 0 if none is passive."""
        if self.damping_n_s_per_m is None:
            return math.inf
        spare = (self.damping_n_s_per_m - abs(self.virtual_damping_n_s_per_m)) / MM_PER_M
        # monotone in v: the worst speed is 0 or the fastest
        resting = 2.0 * self.friction_n / self.resolution_mm if self.resolution_mm > 0.0 else math.inf
        if math.isinf(self.fastest_mm_s):
            moving = 2.0 * spare * self.rate_hz
        else:
            dissipated_n = spare * self.fastest_mm_s + self.friction_n
            moving = 2.0 * dissipated_n / (self.fastest_mm_s / self.rate_hz + self.resolution_mm)
        return max(0.0, min(resting, moving))

    @property
    def allowed_stiffness_n_per_mm(self) -> float:
        """The smaller of stiffness cap and passivity bound."""
        return min(self.stiffness_n_per_m / MM_PER_M, self.passive_stiffness_n_per_mm)

    def require_force(self, what: str, force_n: float) -> None:
        """Refuse a largest force that this device does not hold.

        Raises:
            InvalidInputError: says which, and what to do.
        """
        if force_n <= self.continuous_force_n:
            return
        reason = (
            f"the {self.name} holds {self.continuous_force_n:g} N for long; lower it"
            if self.name
            else f"at most {self.continuous_force_n:g} N is allowed where no stronger device is named; lower "
            "it, or name the device with its continuous_force_n under the key 'device' of the fixtures"
        )
        raise InvalidInputError(f"{what} is {force_n:g} N; {reason}")

    def checked(self, law: L) -> L:
        """The law, if this device can render it.

        Raises:
            InvalidInputError: its cap exceeds the device's continuous force, or its steepest point the
                stiffness cap or the passivity bound.
        """
        self.require_force("force cap cap_n", law.cap_n)
        allowed = self.allowed_stiffness_n_per_mm
        stiffness = law.stiffness_n_per_mm
        if stiffness <= allowed:
            return law
        raise InvalidInputError(
            f"the fixture is too stiff for the device: {stiffness * MM_PER_M:.4g} N/m at its steepest, "
            f"at most {allowed * MM_PER_M:.4g} N/m allowed by {self._reason()}; {_remedy(law, allowed)}"
        )

    def _reason(self) -> str:
        if self.damping_n_s_per_m is None or self.passive_stiffness_n_per_mm >= (
            self.stiffness_n_per_m / MM_PER_M
        ):
            return "its stiffness cap"
        parts = [f"b {self.damping_n_s_per_m:g}", f"|B| {abs(self.virtual_damping_n_s_per_m):g} N·s/m"]
        if self.friction_n > 0.0:
            parts.append(f"dry friction {self.friction_n:g} N up to {self.fastest_mm_s:g} mm/s")
        if self.resolution_mm > 0.0:
            parts.append(f"resolution {self.resolution_mm:g} mm")
        return f"passivity at {self.rate_hz:g} Hz ({', '.join(parts)})"


COMMON_DEVICE = DeviceLimits()
"""1 kHz, 400 N/m and 4 N: assumed where no device is given."""


def _remedy(law: Law, allowed_n_per_mm: float) -> str:
    """Change of the law that makes it passive: γ ≤ 4K/F, δ ≥ c_m F/K."""
    if allowed_n_per_mm <= 0.0:
        return "no stiffness is passive: lower the virtual damping or raise the physical one"
    if not isinstance(law, Gaussian):
        return f"use gamma_per_mm <= {4.0 * allowed_n_per_mm / law.cap_n:.4g} or a lower cap"
    if law.m < 0.5:
        return "use m >= 0.5 (below it the stiffness at the target is unbounded)"
    return f"use delta_mm >= {law.delta_mm * law.stiffness_n_per_mm / allowed_n_per_mm:.4g} or a lower cap"


EXPONENTS = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0)
"""Exponents m among which a design chooses."""


@dataclass(frozen=True, slots=True)
class FreeZone:
    """A zone about the target in which the hand should feel no force.

    Attributes:
        half_width_mm: half-width of the zone.
        detection_threshold_n: the force stays below this within it, for example the threshold of touch.
    """

    half_width_mm: float
    detection_threshold_n: float


def gaussian_for_free_zone(
    zone: FreeZone, *, cap_n: float = 0.6, depth_mm: float = 0.0, device: DeviceLimits = COMMON_DEVICE
) -> Gaussian:
    """The law with the given free zone and the steepest wall about it that the device renders: the largest m.

    Raises:
        InvalidInputError: a zone without width, a threshold beyond the cap, or a zone so narrow that no
            exponent is within the device's stiffness.
    """
    best: Gaussian | None = None
    for m in EXPONENTS:
        law = Gaussian.with_free_zone(
            zone.half_width_mm, zone.detection_threshold_n, m=m, cap_n=cap_n, depth_mm=depth_mm
        )
        if law.stiffness_n_per_mm <= device.allowed_stiffness_n_per_mm:
            best = law
    if best is None:
        narrowest = min(
            (
                law.half_width_mm(zone.detection_threshold_n)
                for law in _stiffest_laws(cap_n, depth_mm, device)
            ),
            default=float("inf"),
        )
        allowed_n_per_m = 1000.0 * device.allowed_stiffness_n_per_mm
        raise InvalidInputError(
            f"a free zone of ±{zone.half_width_mm:g} mm below {zone.detection_threshold_n:g} N needs a "
            f"stiffer wall than the device's {allowed_n_per_m:.4g} N/m; the narrowest it renders is "
            f"±{narrowest:.3g} mm; widen it or lower the cap of {cap_n:g} N"
        )
    return best


def tightest_gaussian(
    friction_n: float, *, cap_n: float = 0.6, depth_mm: float = 0.0, device: DeviceLimits = COMMON_DEVICE
) -> Gaussian:
    """The law with the narrowest dead band under dry friction that the device renders.

    At a given largest stiffness the pull near the target is greatest for m = 1/2, the one exponent whose
    stiffest point is the target itself; for friction close to the cap a larger m can win.

    Raises:
        InvalidInputError: friction beyond the cap, or a device that renders no stiffness.
    """
    laws = _stiffest_laws(cap_n, depth_mm, device)
    if not laws:
        raise InvalidInputError(
            "the device renders no stiffness passively; lower its virtual damping or raise the physical one"
        )
    return min(laws, key=lambda law: law.half_width_mm(friction_n))


def _stiffest_laws(cap_n: float, depth_mm: float, device: DeviceLimits) -> list[Gaussian]:
    """One law for each exponent, as stiff as the device allows: δ = c_m·F/K."""
    stiffness = device.allowed_stiffness_n_per_mm
    if stiffness <= 0.0:
        return []
    # a part in 10⁹ wider, so that rounding does not put the law beyond the limit
    width_mm = (1.0 + 1e-9) * cap_n / stiffness
    return [Gaussian(gaussian_steepness(m) * width_mm, m, cap_n, depth_mm) for m in EXPONENTS]
