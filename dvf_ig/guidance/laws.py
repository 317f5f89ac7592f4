"""Force laws at a signed distance: sigmoid (Ren 2008, eqs 4–6) and Gaussian (eqs 7–9), Sections IV and V.

Every law is F = −cap·f(s)·n with s = d − depth, d > 0 inside the organ and n = ∇d/|∇d|. The readable form of
f is here; `dvf_ig.kernels.laws` holds the same formula for the servo loop. Where |∇d| falls below 0.4 the
direction is uncertain, and every law is faded by smoothstep(|∇d|, 0.2, 0.4) (`static_force`).
"""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.kernels.laws import GAUSSIAN, LARGEST_FORCE_N, SIGMOID

FELT_SHARE = 0.01
"""A forbidden region counts as felt from this share of its cap on: 6 mN of 0.6 N."""
REACH_MM = 20.0
"""A wall that is felt further outside its surface guards nothing in particular: a heart is 80 mm wide."""
_REACH_WIDTHS = math.log(1.0 / FELT_SHARE - 1.0)


@dataclass(frozen=True, slots=True)
class _Wall:
    """Wall whose force rises along a sigmoid, half of the cap at the guarded depth.

    Attributes:
        gamma_per_mm: steepness γ.
        cap_n: largest force F, at most 20 N.
        depth_mm: depth of the guarded surface in what is forbidden (negative: before the wall's surface).
    """

    gamma_per_mm: float = 1.0
    cap_n: float = 0.6
    depth_mm: float = 0.0

    def __post_init__(self) -> None:
        _require_positive(f"{type(self).__name__.lower()} steepness gamma_per_mm", self.gamma_per_mm, "1/mm")
        require_force("force cap cap_n", self.cap_n)
        _require_finite("guarded depth depth_mm", self.depth_mm)

    @property
    def reach_mm(self) -> float:
        """Distance before the wall's surface up to which 1 % of the cap is felt: ln(99)/γ − depth."""
        return _REACH_WIDTHS / self.gamma_per_mm - self.depth_mm

    @property
    def stiffness_n_per_mm(self) -> float:
        """Largest |dF/dd|: γF/4, at the guarded depth."""
        return self.gamma_per_mm * self.cap_n / 4.0


@dataclass(frozen=True, slots=True)
class Sigmoid(_Wall):
    """Forbidden region (eqs 4–6): pushes out of the organ."""

    def potential(self, distance_mm: FloatArray) -> FloatArray:
        """f in (0, 1) at signed distances."""
        s = np.asarray(distance_mm, dtype=np.float64) - self.depth_mm
        return np.asarray(0.5 * (1.0 + np.tanh(0.5 * self.gamma_per_mm * s)))

    @property
    def parameters(self) -> FloatArray:
        """(5,) kind, scale, exponent, cap, depth: what the kernels take."""
        return np.array([SIGMOID, self.gamma_per_mm, 1.0, self.cap_n, self.depth_mm])


@dataclass(frozen=True, slots=True)
class Confinement(_Wall):
    """Confinement inside a chamber: a sigmoid of s = −d − depth, d the distance field of the cavity.

    The wall around the cavity is what is forbidden: the force points into the chamber. The kernels need no
    separate law for it: cap·σ(γ(−d − depth)) is a sigmoid of steepness −γ, depth −depth and cap −cap.
    """

    def potential(self, distance_mm: FloatArray) -> FloatArray:
        """−f in (−1, 0) at signed distances of the cavity: against ∇d the force would leave the chamber."""
        s = -np.asarray(distance_mm, dtype=np.float64) - self.depth_mm
        return np.asarray(-0.5 * (1.0 + np.tanh(0.5 * self.gamma_per_mm * s)))

    @property
    def parameters(self) -> FloatArray:
        """(5,) kind, scale, exponent, cap, depth: what the kernels take."""
        return np.array([SIGMOID, -self.gamma_per_mm, 1.0, -self.cap_n, -self.depth_mm])


@dataclass(frozen=True, slots=True)
class Gaussian:
    """Guidance to a surface (eqs 7–9): pulls back to the guarded depth from either side.

    Attributes:
        delta_mm: width δ at which the force reaches 63 % of the cap.
        m: exponent; the larger, the flatter the free zone and the steeper its wall.
        cap_n: largest force F, at most 20 N.
        depth_mm: depth of the target surface below the organ's.
    """

    delta_mm: float = 3.0
    m: float = 1.0
    cap_n: float = 0.6
    depth_mm: float = 0.0

    def __post_init__(self) -> None:
        _require_positive("Gaussian width delta_mm", self.delta_mm, "mm")
        _require_positive("Gaussian exponent m", self.m, "")
        require_force("force cap cap_n", self.cap_n)
        _require_finite("guarded depth depth_mm", self.depth_mm)

    def potential(self, distance_mm: FloatArray) -> FloatArray:
        """f(s)·sign(s) in (−1, 1) at signed distances."""
        s = np.asarray(distance_mm, dtype=np.float64) - self.depth_mm
        return np.asarray(np.sign(s) * -np.expm1(-(((s / self.delta_mm) ** 2) ** self.m)))

    @property
    def reach_mm(self) -> float:
        """Infinite: guidance pulls from everywhere (eqs 7–9); its cap alone bounds it."""
        return math.inf

    @property
    def stiffness_n_per_mm(self) -> float:
        """Largest |dF/dd|: c_m·F/δ; infinite for m < 1/2."""
        return gaussian_steepness(self.m) * self.cap_n / self.delta_mm

    @classmethod
    def with_free_zone(
        cls,
        half_width_mm: float,
        detection_threshold_n: float,
        *,
        m: float = 2.0,
        cap_n: float = 0.6,
        depth_mm: float = 0.0,
    ) -> "Gaussian":
        """The law whose force stays below `detection_threshold_n` within `half_width_mm` of its target.

        δ = w/[−ln(1 − f_t/F)]^(1/2m) (docs/theory/fixtures.md).
        """
        _require_positive("free zone half_width_mm", half_width_mm, "mm")
        unit = cls(1.0, m, cap_n, depth_mm)
        return cls(half_width_mm / unit.half_width_mm(detection_threshold_n), m, cap_n, depth_mm)

    def half_width_mm(self, force_n: float) -> float:
        """Distance from the target at which the pull reaches `force_n`: δ[−ln(1 − f/F)]^(1/2m).

        For the detection threshold of the hand this is the free zone; for the dry friction of a device it is
        the dead band in which the fixture cannot move it.

        Raises:
            InvalidInputError: a force that is not between 0 and the cap.
        """
        if not 0.0 < force_n < self.cap_n:
            raise InvalidInputError(
                f"threshold force is {force_n:g} N; it must lie between 0 and the cap of {self.cap_n:g} N"
            )
        return float(self.delta_mm * (-math.log1p(-force_n / self.cap_n)) ** (0.5 / self.m))

    @property
    def parameters(self) -> FloatArray:
        """(5,) kind, scale, exponent, cap, depth: what the kernels take."""
        return np.array([GAUSSIAN, self.delta_mm, self.m, self.cap_n, self.depth_mm])


Law = Sigmoid | Confinement | Gaussian


def gaussian_steepness(m: float) -> float:
    """c_m, the steepest slope of 1 − exp(−|x|^n), n = 2m: n·u^u·e^(−u) with u = (n−1)/n.

    The slope n·|x|^(n−1)·exp(−|x|^n) is greatest where |x|^n = u.
    Infinite for m < 1/2, where it grows without bound towards the target.
    """
    n = 2.0 * m
    if n < 1.0:
        return math.inf
    u = (n - 1.0) / n
    return float(n * u**u * math.exp(-u))


def require_force(what: str, force_n: float) -> None:
    """Refuse a largest force that is not positive, or that no device holds.

    Raises:
        InvalidInputError: says which and how large.
    """
    _require_positive(what, force_n, "N")
    if force_n > LARGEST_FORCE_N:
        raise InvalidInputError(f"{what} is {force_n:g} N; no device holds more than {LARGEST_FORCE_N:g} N")


def require_reach(law: Law, margin_mm: float = 0.0) -> None:
    """Refuse a forbidden region that is felt too far from the surface that it guards, widened by a margin.

    Raises:
        InvalidInputError: says how far, and what to do.
    """
    reach_mm = law.reach_mm + margin_mm
    if isinstance(law, Gaussian) or reach_mm <= REACH_MM * (1.0 + 1e-9):
        return
    wanted_mm = REACH_MM - margin_mm + law.depth_mm
    least = math.ceil(1000.0 * _REACH_WIDTHS / wanted_mm) / 1000.0 if wanted_mm > 0.0 else math.inf
    remedy = f"use a gamma of {least:g} or more, or" if math.isfinite(least) else "use"
    margin = f" and a margin of {margin_mm:g} mm" if margin_mm > 0.0 else ""
    raise InvalidInputError(
        f"with gamma {law.gamma_per_mm:g}, depth_mm {law.depth_mm:g}{margin} {FELT_SHARE:.0%} of the force "
        f"would be felt {reach_mm:.4g} mm from the organ's surface, at most {REACH_MM:g} mm is allowed; "
        f"{remedy} a larger depth_mm"
    )


def _require_positive(what: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InvalidInputError(f"{what} is {value:g} {unit}".rstrip() + "; it must be positive and finite")


def _require_finite(what: str, value: float) -> None:
    if not math.isfinite(value):
        raise InvalidInputError(f"{what} is {value:g} mm; it must be finite")
