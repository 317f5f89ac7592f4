"""Hand on a haptic device that holds an instrument, which a servo drives and an operator moves."""

from dataclasses import dataclass

import numpy as np

from data_synth.kernels import held_instrument as kernel
from dvf_ig.core import FloatArray, InvalidInputError

from .fulcrum import Fulcrum

MM_PER_M = 1000.0


@dataclass(frozen=True, slots=True)
class Stylus:
    """Moving parts of a haptic device at its stylus.

    Attributes:
        mass_kg: apparent mass; viscous_n_s_per_m, dry_n: its frictions.
        resolution_mm: step of its position sensor; largest_n: longer forces are limited to it.
        delay_s: delay between sending of a force and its action.
    """

    mass_kg: float
    viscous_n_s_per_m: float
    dry_n: float
    resolution_mm: float = 0.0
    largest_n: float = np.inf
    delay_s: float = 0.0


@dataclass(frozen=True, slots=True)
class HandDynamics:
    """Dynamics of a hand that holds a stylus (docs/theory/synthetic.md).

    Attributes:
        mass_kg, damping_n_s_per_m, stiffness_n_per_m: about the intended position.
    """

    mass_kg: float = 0.12
    damping_n_s_per_m: float = 3.0
    stiffness_n_per_m: float = 100.0


class HeldInstrument:
    """Hand, device and instrument as one mass, moved in the servo's own time.

    Fulfils the protocol of a haptic device whose position is the instrument's tip and whose force acts
    there: a servo calls `functions` with `context`. Frame "device" throughout.

    Args:
        tip_mm: (3,) start of the tip, at rest.
        hand: dynamics of the operator's hand; stylus: of the device.
        fulcrum: None: the tip is in the hand.
        stated_latency_s: delay that the device states; None: the truth.
    Raises:
        InvalidInputError: a delay that is negative or longer than the queue of forces.
    """

    def __init__(
        self,
        tip_mm: FloatArray,
        hand: HandDynamics,
        stylus: Stylus,
        *,
        fulcrum: Fulcrum | None = None,
        stated_latency_s: float | None = None,
    ) -> None:
        longest_s = 1e-3 * (kernel.QUEUE_LENGTH - 2)
        if not 0.0 <= stylus.delay_s <= longest_s:
            raise InvalidInputError(
                f"the device's delay is {stylus.delay_s:g} s; needed 0 to {longest_s:g} s"
            )
        self.name = "simulated hand on a simulated device"
        self.latency_s = stylus.delay_s if stated_latency_s is None else stated_latency_s
        self.fulcrum = fulcrum
        self.mass_kg = hand.mass_kg + stylus.mass_kg
        self.context = np.zeros(kernel.CONTEXT_SIZE, dtype=np.int64)
        self.functions = np.array([kernel.read_instrument.address, kernel.write_instrument.address])
        numbers = self._numbers
        numbers[: kernel.HAND_MM_S] = tip_mm if fulcrum is None else fulcrum.hand(tip_mm)
        numbers[kernel.MASS_KG : kernel.DELAY_S + 1] = (
            self.mass_kg,
            hand.stiffness_n_per_m / MM_PER_M,
            hand.damping_n_s_per_m / MM_PER_M,
            stylus.viscous_n_s_per_m / MM_PER_M,
            stylus.dry_n,
            stylus.largest_n,
            stylus.resolution_mm,
            stylus.delay_s,
        )
        if fulcrum is not None:
            numbers[kernel.LENGTH_MM] = fulcrum.length_mm
            numbers[kernel.FULCRUM_MM : kernel.QUEUED] = fulcrum.point_mm
        self.command(self.hand_mm, np.zeros(3))

    @property
    def _numbers(self) -> FloatArray:
        return self.context.view(np.float64)

    @property
    def hand_mm(self) -> FloatArray:
        """True position (3,) of the hand."""
        return self._numbers[: kernel.HAND_MM_S].copy()

    @property
    def hand_mm_s(self) -> FloatArray:
        """(3,) its velocity."""
        return self._numbers[kernel.HAND_MM_S : kernel.FORCE_N].copy()

    @property
    def tip_mm(self) -> FloatArray:
        """True position (3,) of the tip."""
        return self.hand_mm if self.fulcrum is None else self.fulcrum.tip(self.hand_mm)

    @property
    def felt_n(self) -> FloatArray:
        """Force (3,) of the device on the hand that acts now."""
        return self._numbers[kernel.FELT_N : kernel.LAST_S].copy()

    def command(self, place_mm: FloatArray, push_n: FloatArray) -> None:
        """Set the hand's intention from now on.

        Args:
            place_mm: (3,) intended position, to which its spring pulls.
            push_n: (3,) further muscle force.
        """
        numbers = self._numbers
        numbers[kernel.PLACE_MM : kernel.PUSH_N] = place_mm
        numbers[kernel.PUSH_N : kernel.LENGTH_MM] = push_n

    def close(self) -> None:
        """Close the device, which holds no resources."""
