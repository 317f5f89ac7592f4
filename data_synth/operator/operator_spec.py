"""Parameters of a simulated operator, and the spread between operators."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from data_synth.seeds import child_rng
from dvf_ig.core import InvalidInputError

from .hand import TREMOR_RMS_MM
from .held_instrument import HandDynamics

SPREAD = 0.15
"""Standard deviation of the logarithm of each parameter between operators, cut off at twice that."""
TIMING_SD_S = 0.025
LEVER_GAIN_SD = 0.10
MISALIGNED_SD_RAD = math.radians(10.0)


@dataclass(frozen=True, slots=True)
class OperatorSpec:
    """Parameters of a simulated operator.

    Attributes:
        hand: mass, damping, stiffness.
        visual_delay_s: delay from a visible position to the hand's response.
        crossover_rad_s: crossover frequency of the loop that vision closes.
        depth_noise_mm: RMS error of depth as seen, along the line of sight.
        sideways_noise_mm: RMS error as seen in each direction across it.
        noise_hz: band of both errors and of the felt force's: slow, as of judgement.
        tremor_rms_mm: RMS tremor of a free hand, in space.
        anticipated_share: share of the target's periodic motion that the hand anticipates.
        timing_error_s: time by which the anticipation is early.
        haptic_delay_s: delay from a force to the hand's voluntary response.
        force_noise_n, weber: RMS error of a felt force, the root of the sum of the squares of `force_noise_n`
            and the share `weber` of the force. A force below `force_noise_n` is not felt.
        attends: whether felt force is used as information on depth; if not, it only moves the hand.
        lever_gain: assumed over true lever of a fulcrum.
        misaligned_rad: turn about the instrument between the hand's and the image's directions.
    Raises:
        InvalidInputError: a number that is negative or not finite.
    Source: docs/theory/synthetic.md: hand, delay, crossover, tremor, depth noise. Crossover model: McRuer
        and Jex 1967. The rest is assumed.
    """

    hand: HandDynamics = field(default_factory=HandDynamics)
    visual_delay_s: float = 0.2
    crossover_rad_s: float = 3.5
    depth_noise_mm: float = 0.8
    sideways_noise_mm: float = 0.2
    noise_hz: tuple[float, float] = (0.05, 0.5)
    tremor_rms_mm: float = TREMOR_RMS_MM
    anticipated_share: float = 0.8
    timing_error_s: float = 0.0
    haptic_delay_s: float = 0.12
    force_noise_n: float = 0.05
    weber: float = 0.1
    attends: bool = True
    lever_gain: float = 1.0
    misaligned_rad: float = 0.0

    def __post_init__(self) -> None:
        for name in (
            "visual_delay_s",
            "crossover_rad_s",
            "depth_noise_mm",
            "sideways_noise_mm",
            "tremor_rms_mm",
            "anticipated_share",
            "haptic_delay_s",
            "force_noise_n",
            "weber",
            "lever_gain",
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidInputError(f"operator {name} is {value:g}; it must be finite and not negative")


def drawn_operator(seed: int, mean: OperatorSpec) -> OperatorSpec:
    """Draw one of many operators: parameters about those of `mean`.

    The same seed gives the same person for any mean.
    """
    rng = child_rng(seed, "operator")
    factor = np.exp(SPREAD * np.clip(rng.standard_normal(7), -2.0, 2.0)).tolist()
    hand = replace(
        mean.hand,
        damping_n_s_per_m=mean.hand.damping_n_s_per_m * factor[0],
        stiffness_n_per_m=mean.hand.stiffness_n_per_m * factor[1],
    )
    late, gain, turn = np.clip(rng.standard_normal(3), -2.0, 2.0).tolist()
    return replace(
        mean,
        hand=hand,
        visual_delay_s=mean.visual_delay_s * factor[2],
        crossover_rad_s=mean.crossover_rad_s * factor[3],
        depth_noise_mm=mean.depth_noise_mm * factor[4],
        sideways_noise_mm=mean.sideways_noise_mm * factor[4],
        anticipated_share=min(0.95, mean.anticipated_share * factor[5]),
        haptic_delay_s=mean.haptic_delay_s * factor[6],
        timing_error_s=mean.timing_error_s + TIMING_SD_S * late,
        lever_gain=mean.lever_gain * math.exp(LEVER_GAIN_SD * gain),
        misaligned_rad=mean.misaligned_rad + MISALIGNED_SD_RAD * turn,
    )
