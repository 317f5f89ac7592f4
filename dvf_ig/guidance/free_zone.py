"""Design of Gaussian fixtures (eqs 7–9): from a free zone, or for the narrowest dead band a device allows."""

from dataclasses import dataclass

from dvf_ig.core import InvalidInputError

from .device import COMMON_DEVICE, DeviceLimits
from .laws import Gaussian, gaussian_steepness

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
