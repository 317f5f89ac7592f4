"""Simulated operator with delayed, noisy vision, faster touch, and a hand that has mass and tremor.

Vision closes a loop by the crossover model: the intended position moves with

    ṗ = ẋ_preview + ω_c e(t − τ),          e = aim − tip, as seen

so that, the hand following its intention, the open loop is ω_c e^(−sτ)/s (McRuer and Jex 1967). Along a force
that is felt, e is the mean of the seen and the felt error, each weighted by one over its variance (Ernst and
Banks 2002). The hand is a spring and damper about the intended position (`HeldInstrument`); its own damping,
and its inertia in previewed motion, are known to the operator and add to the muscles' force.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from data_synth.seeds import child_rng
from data_synth.signals.smooth_noise import smooth_noise
from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import frozen_floats

from .hand import TREMOR_RMS_MM, tremor
from .held_instrument import MM_PER_M, HeldInstrument
from .operator_spec import OperatorSpec


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LearntForce:
    """Learnt distance to move along a felt force, by its size.

    Attributes:
        force_n: (n,) increasing, n >= 2.
        correction_mm: (n,) increasing: along the force to the intended position; negative: against it.
    """

    force_n: FloatArray
    correction_mm: FloatArray

    def __post_init__(self) -> None:
        force = frozen_floats(self.force_n, "learnt forces", (None,))
        correction = frozen_floats(self.correction_mm, "learnt corrections", (len(force),))
        if len(force) < 2 or (np.diff(force) <= 0.0).any() or (np.diff(correction) <= 0.0).any():
            raise InvalidInputError("a learnt force needs at least 2 increasing forces and corrections")
        object.__setattr__(self, "force_n", force)
        object.__setattr__(self, "correction_mm", correction)

    def read(self, force_n: float) -> tuple[float, float]:
        """Return the correction in mm and its slope in mm per N; constant beyond the ends."""
        i = int(np.clip(np.searchsorted(self.force_n, force_n) - 1, 0, len(self.force_n) - 2))
        low_n, high_n = self.force_n[i : i + 2].tolist()
        low_mm, high_mm = self.correction_mm[i : i + 2].tolist()
        slope = (high_mm - low_mm) / (high_n - low_n)
        at = min(max(force_n, low_n), high_n)
        return low_mm + slope * (at - low_n), slope


RATE_HZ = 100
"""Steps of the operator a second."""
LONGEST_S = 240.0
"""Longest duration of a task."""


class SimulatedOperator:
    """One person with one instrument in hand.

    Random errors at each time depend only on the seed, so that two runs of the same seed differ only by what
    the operator encounters.

    Args:
        spec: parameters of the operator.
        seed: seed of judgement errors and tremor.
        instrument: instrument in hand.
        sight: (3,) unit line of sight.
        learnt: learnt meaning of the fixture's force; None: unknown.
    """

    def __init__(
        self,
        spec: OperatorSpec,
        seed: int,
        instrument: HeldInstrument,
        sight: FloatArray,
        learnt: LearntForce | None = None,
    ) -> None:
        self.spec, self._instrument, self._sight = spec, instrument, sight
        self._learnt = learnt if spec.attends else None
        low, high = spec.noise_hz
        seen = smooth_noise(3, low, high, child_rng(seed, "seen"))
        felt = smooth_noise(1, low, high, child_rng(seed, "felt"))
        t_s = np.arange(round(LONGEST_S * RATE_HZ)) / RATE_HZ
        error = seen(t_s)
        more_mm = spec.depth_noise_mm - spec.sideways_noise_mm
        self._seen_error = spec.sideways_noise_mm * error + more_mm * np.outer(error @ sight, sight)
        self._felt_error = felt(t_s)[:, 0]
        self._tremor_n = self._tremor_force(t_s, seed)
        self._seen = _nothing_yet(spec.visual_delay_s)
        self._felt = _nothing_yet(spec.haptic_delay_s)
        self._place = instrument.hand_mm
        self._preview_mm_s = np.zeros(3)
        self._step = 0
        self.believed_error_mm = 0.0
        """Distance between aim and tip in the last step, by all that is seen and felt."""

    def step(self, aim_mm: FloatArray, preview_mm_s: FloatArray) -> None:
        """See, feel and decide; the hand acts on it until the next step, 1/RATE_HZ later.

        Args:
            aim_mm: (3,) position at which the tip should be now.
            preview_mm_s: (3,) velocity of the aim as far as it is anticipated.
        """
        spec, instrument = self.spec, self._instrument
        tip, k = instrument.tip_mm, self._step
        hand_per_tip = self._believed(tip)
        self._seen.append(aim_mm - tip)
        self._felt.append(hand_per_tip.T @ instrument.felt_n)
        believed = self._with_felt(self._seen[0] + self._seen_error[k], self._felt[0], k)
        self.believed_error_mm = float(np.linalg.norm(believed))
        correction = spec.crossover_rad_s * believed
        ahead = hand_per_tip @ preview_mm_s
        velocity = ahead + hand_per_tip @ correction
        self._place = self._place + velocity / RATE_HZ
        push = spec.hand.damping_n_s_per_m * velocity
        push += instrument.mass_kg * (ahead - self._preview_mm_s) * RATE_HZ
        self._preview_mm_s = ahead
        instrument.command(self._place, push / MM_PER_M + self._tremor_n[k])
        self._step += 1

    def _with_felt(self, seen: FloatArray, force_n: FloatArray, k: int) -> FloatArray:
        """Combine the seen error (3,) with the felt one along a felt force."""
        spec, size = self.spec, float(np.linalg.norm(force_n))
        if self._learnt is None or size < spec.force_noise_n:
            return seen
        sigma_n = float(np.hypot(spec.force_noise_n, spec.weber * size))
        along = force_n / size
        says_mm, mm_per_n = self._learnt.read(size + sigma_n * float(self._felt_error[k]))
        in_sight = float(along @ self._sight) ** 2
        seen_variance = in_sight * spec.depth_noise_mm**2 + (1.0 - in_sight) * spec.sideways_noise_mm**2
        weight = seen_variance / (seen_variance + (mm_per_n * sigma_n) ** 2)
        return np.asarray(seen + weight * (says_mm - float(seen @ along)) * along)

    def _believed(self, tip_mm: FloatArray) -> FloatArray:
        """Return (3, 3) the hand's velocity for the tip's, in the operator's mental model."""
        fulcrum, spec = self._instrument.fulcrum, self.spec
        if fulcrum is None:
            return np.eye(3)
        u = fulcrum.point_mm - tip_mm
        u = u / np.linalg.norm(u)
        along = np.outer(u, u)
        x, y, z = u.tolist()
        across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turned = math.cos(spec.misaligned_rad) * (np.eye(3) - along) + math.sin(spec.misaligned_rad) * across
        return np.asarray(along - turned / (spec.lever_gain * fulcrum.lever(tip_mm)))

    def _tremor_force(self, t_s: FloatArray, seed: int) -> FloatArray:
        """Compute (n, 3) N that moves the free hand by its tremor."""
        hand, instrument = self.spec.hand, self._instrument
        scale = self.spec.tremor_rms_mm / TREMOR_RMS_MM
        x = scale * tremor(child_rng(seed, "tremor"))(t_s)
        v = np.gradient(x, t_s, axis=0)
        a = np.gradient(v, t_s, axis=0)
        mass, damping = instrument.mass_kg, hand.damping_n_s_per_m
        return np.asarray((mass * a + damping * v + hand.stiffness_n_per_m * x) / MM_PER_M)


def _nothing_yet(delay_s: float) -> deque[FloatArray]:
    """Create an empty delay line, oldest value first."""
    length = 1 + round(delay_s * RATE_HZ)
    return deque([np.zeros(3)] * length, maxlen=length)
