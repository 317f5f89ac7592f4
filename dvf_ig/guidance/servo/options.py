"""How a servo runs: rate, prediction, damping, passivity."""

import math
from dataclasses import dataclass

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance.feed_forward import NO_FEED_FORWARD, FeedForward
from dvf_ig.guidance.tissue import Feel

SLOWEST_HZ, FASTEST_HZ = 200.0, 4000.0
"""The watchdog trips 10 ms after a force: at the slowest rate one deadline may be missed."""
SPEED_CUTOFF_HZ = 50.0
"""Of the low-pass filter on the tool's measured speed."""


@dataclass(frozen=True, slots=True)
class ServoOptions:
    """Options of a servo.

    Attributes:
        rate_hz: ticks a second, 200 to 4000.
        feed_forward: damping relative to the surface, and compensation of friction along its motion.
        largest_damping_n_s_per_m: of the passivity controller; 0 switches it off, its observer stays. Sampled
            damping is stable by itself below the apparent mass over the period, 72 N·s/m of 72 g at 1 kHz; a
            sensor step of 0.03 mm in 1 ms times 2 N·s/m is a force of 0.06 N.
        residual_limit_mj: energy made by sampling, latency and quantisation beyond which the force is
            withdrawn (docs/theory/safety.md).
        predict_tool: take the tool to where it will be when the force is felt; pose and phase always are.
        feel: tissue that is felt instead of the fixtures, whose joint cap stays; None: the fixtures are.
    Raises:
        InvalidInputError: a number out of range.
    """

    rate_hz: float = 1000.0
    feed_forward: FeedForward = NO_FEED_FORWARD
    largest_damping_n_s_per_m: float = 2.0
    residual_limit_mj: float = 5.0
    predict_tool: bool = True
    feel: Feel | None = None

    def __post_init__(self) -> None:
        if not SLOWEST_HZ <= self.rate_hz <= FASTEST_HZ:
            raise InvalidInputError(
                f"the servo's rate is {self.rate_hz:g} Hz; needed {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz"
            )
        for name in ("largest_damping_n_s_per_m", "residual_limit_mj"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidInputError(
                    f"servo option {name} is {value:g}; it must be finite and not negative"
                )

    @property
    def period_ns(self) -> int:
        return round(1e9 / self.rate_hz)
