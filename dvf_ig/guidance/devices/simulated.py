"""Simulated haptic stylus: mass, viscous and dry friction, sensor resolution and servo rate."""

import math
from dataclasses import dataclass, field

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import frozen_floats
from dvf_ig.guidance.device import UNNAMED_FORCE_N, DeviceLimits
from dvf_ig.guidance.feed_forward import NO_FEED_FORWARD, FeedForward
from dvf_ig.kernels.device import MM_PER_M, advance
from dvf_ig.kernels.servo import simulated as kernel


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class DeviceState:
    """Position and velocity of the stylus tip.

    Attributes:
        position_mm: (3,), frame "device".
        velocity_mm_s: (3,).
    """

    position_mm: FloatArray
    velocity_mm_s: FloatArray

    def __post_init__(self) -> None:
        for name in ("position_mm", "velocity_mm_s"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), f"device {name}", (3,)))

    @classmethod
    def at_rest(cls, position_mm: FloatArray) -> "DeviceState":
        return cls(position_mm, np.zeros(3))


@dataclass(frozen=True, slots=True)
class SimulatedDevice:
    """A gravity-compensated stylus: the same apparent mass and friction in every direction.

    Attributes:
        name: the device it models.
        mass_kg: apparent mass at the tip.
        viscous_n_s_per_m: viscous friction at the tip.
        dry_n: dry (Coulomb) friction at the tip, equal for static and sliding contact.
        resolution_mm: step of the position sensor; 0 measures exactly.
        largest_n: longer forces are limited to this.
        rate_hz: servo rate; a force is held for one period.
        steps: sub-steps of a period.
        continuous_n: largest force that it holds for long.
    """

    name: str
    mass_kg: float
    viscous_n_s_per_m: float
    dry_n: float
    resolution_mm: float = 0.0
    largest_n: float = math.inf
    rate_hz: float = 1000.0
    steps: int = 10
    continuous_n: float = UNNAMED_FORCE_N

    def __post_init__(self) -> None:
        for name, low in (("mass_kg", 1e-4), ("rate_hz", 1.0), ("steps", 1)):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= low):
                raise InvalidInputError(f"device {name} is {value:g}; needed a finite number from {low:g} on")
        for name in ("viscous_n_s_per_m", "dry_n", "resolution_mm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidInputError(f"device {name} is {value:g}; it must be finite and not negative")
        if not self.largest_n > 0.0:
            raise InvalidInputError(f"device largest_n is {self.largest_n:g} N; it must be positive")

    def step(self, state: DeviceState, force_n: FloatArray) -> DeviceState:
        """The state one servo period later, under a force (3,) in N held meanwhile.

        A force that is not finite is replaced by zero.
        """
        before = np.concatenate([state.position_mm, state.velocity_mm_s])
        after = np.empty(6)
        advance(before, np.array(force_n, dtype=np.float64), *self.constants, after)
        return DeviceState(after[:3], after[3:])

    def measured_mm(self, position_mm: FloatArray) -> FloatArray:
        """(3,) position as the sensor reports it: rounded to its resolution."""
        if self.resolution_mm == 0.0:
            return np.array(position_mm)
        return np.asarray(np.round(position_mm / self.resolution_mm) * self.resolution_mm)

    @property
    def constants(self) -> tuple[float, float, float, float, float, int]:
        """Mass, viscous and dry friction, largest force, period, sub-steps: for `kernels.device.advance`."""
        return (
            self.mass_kg,
            self.viscous_n_s_per_m,
            self.dry_n,
            self.largest_n,
            1.0 / self.rate_hz,
            self.steps,
        )

    def limits(
        self,
        *,
        fastest_mm_s: float,
        stiffness_n_per_m: float = 400.0,
        feed_forward: FeedForward = NO_FEED_FORWARD,
    ) -> DeviceLimits:
        """Limits within which this device is passive while its tip moves no faster than `fastest_mm_s`.

        Friction compensated by a feed-forward dissipates nothing, and its damping reduces the passivity
        margin.

        Raises:
            InvalidInputError: a feed-forward that compensates more friction than there is.
        """
        if feed_forward.friction_n > self.dry_n:
            raise InvalidInputError(
                f"the feed-forward compensates {feed_forward.friction_n:g} N of friction, but {self.name} "
                f"has {self.dry_n:g} N; compensate less"
            )
        return DeviceLimits(
            rate_hz=self.rate_hz,
            stiffness_n_per_m=stiffness_n_per_m,
            damping_n_s_per_m=self.viscous_n_s_per_m,
            virtual_damping_n_s_per_m=feed_forward.damping_n_s_per_m,
            friction_n=self.dry_n - feed_forward.friction_n,
            resolution_mm=self.resolution_mm,
            fastest_mm_s=fastest_mm_s,
            continuous_force_n=min(self.continuous_n, self.largest_n),
            name=self.name,
        )


PREMIUM = SimulatedDevice("PHANToM Premium 1.0", 0.072, 0.005, 0.038, 0.03, 8.5, continuous_n=1.4)
"""A research device: mass and frictions as identified by Diolaiti, Niemeyer, Barbagli and Salisbury (IEEE
Trans. Robotics 22(2), 2006); resolution, largest and continuous force from its maker (SensAble: 0.03 mm,
8.5 N, 1.4 N)."""

OMNI = SimulatedDevice("PHANToM Omni", 0.045, 0.005, 0.26, 0.055, 3.3, continuous_n=0.88)
"""A desktop stylus: its maker's apparent mass (45 g), back-drive friction (0.26 N), resolution (0.055 mm),
largest (3.3 N) and continuous force (0.88 N). No viscous friction is published: that of the Premium is
used."""

FASTEST_MM_S = 200.0
"""Speed of a hand up to which the limits of a simulated stylus hold."""

DEVICES = {"premium": PREMIUM, "omni": OMNI}
"""Simulated devices by name."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Hand:
    """A hand on a simulated stylus: a constant push, and a spring and damper to a place.

    Attributes:
        push_n: (3,) N.
        place_mm: (3,) where the spring pulls to.
        stiffness_n_per_m, damping_n_s_per_m: of the hand.
    """

    push_n: FloatArray = field(default_factory=lambda: np.zeros(3))
    place_mm: FloatArray = field(default_factory=lambda: np.zeros(3))
    stiffness_n_per_m: float = 0.0
    damping_n_s_per_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("push_n", "place_mm"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), f"hand {name}", (3,)))


NO_HAND = Hand()


class SimulatedStylus:
    """A simulated device in motion: a `HapticDevice` that moves in the loop's own time.

    Args:
        device: mass, frictions, resolution.
        position_mm: (3,) where it starts, at rest, frame "device".
        delay_s: from a force that is sent to the force that acts.
        hand: on the stylus; may be changed while it moves.
    Raises:
        InvalidInputError: a delay that is negative or longer than the queue of forces.
    """

    def __init__(
        self,
        device: SimulatedDevice,
        position_mm: FloatArray,
        *,
        delay_s: float = 0.0,
        hand: Hand = NO_HAND,
    ) -> None:
        longest_s = (kernel.QUEUE_LENGTH - 2) / device.rate_hz
        if not 0.0 <= delay_s <= longest_s:
            raise InvalidInputError(f"the device's delay is {delay_s:g} s; needed 0 to {longest_s:g} s")
        self.device, self.rate_hz = device, device.rate_hz
        self.name = f"simulated {device.name}"
        self.pressed = False
        self.latency_s = delay_s
        self.context = np.zeros(kernel.CONTEXT_SIZE, dtype=np.int64)
        self.functions = np.array([kernel.read_simulated.address, kernel.write_simulated.address])
        numbers = self._numbers
        numbers[:3] = position_mm
        numbers[kernel.MASS_KG : kernel.DELAY_S + 1] = (
            device.mass_kg,
            device.viscous_n_s_per_m,
            device.dry_n,
            device.largest_n,
            1.0 / (device.rate_hz * device.steps),
            device.resolution_mm,
            delay_s,
        )
        self.hold(hand)

    @property
    def limits(self) -> DeviceLimits:
        """Its continuous force, and the largest stiffness at which it is passive up to FASTEST_MM_S."""
        whole = self.device.limits(fastest_mm_s=FASTEST_MM_S)
        return DeviceLimits(
            rate_hz=self.rate_hz,
            stiffness_n_per_m=MM_PER_M * whole.allowed_stiffness_n_per_mm,
            friction_n=whole.friction_n,
            continuous_force_n=whole.continuous_force_n,
            name=self.name,
        )

    @property
    def _numbers(self) -> FloatArray:
        return self.context.view(np.float64)

    @property
    def position_mm(self) -> FloatArray:
        """(3,) true position now, frame "device"."""
        return self._numbers[:3].copy()

    def place(self, position_mm: FloatArray) -> None:
        """Put the tip at (3,) mm, at rest; for a stylus that no servo drives yet."""
        self._numbers[:6] = np.append(position_mm, np.zeros(3))

    def hold(self, hand: Hand) -> None:
        """Another hand from now on."""
        numbers = self._numbers
        numbers[kernel.HAND_N : kernel.HAND_N + 3] = hand.push_n
        numbers[kernel.HAND_MM : kernel.HAND_MM + 3] = hand.place_mm
        numbers[kernel.HAND_STIFFNESS] = hand.stiffness_n_per_m / MM_PER_M
        numbers[kernel.HAND_DAMPING] = hand.damping_n_s_per_m / MM_PER_M

    def enable_force(self) -> None:
        """No watchdog switches its forces off."""

    @property
    def ends_force_after_s(self) -> float:
        """It ends with its program."""
        return 0.0

    def close(self) -> None:
        """No resource is open."""
