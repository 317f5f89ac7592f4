"""What a session is given before its first event."""

from dataclasses import dataclass

from dvf_ig.cardiac import RetimeMode
from dvf_ig.core import Fan, Rigid
from dvf_ig.guidance import FORBIDDEN_SURFACE, DeviceLimits, FixtureSet

from .calibrations import CalibrationsInUse
from .heart import Heart
from .heart_clock import BeatSource


@dataclass(frozen=True, slots=True, eq=False)
class SessionSetup:
    """Patient, calibrations and fixtures of one intervention.

    Attributes:
        heart: the fixture model and what ultrasound is registered to.
        calibrations: tool tip, image and latency.
        beat_source: ECG or trigger, and what is known of it.
        start: coarse mr_from_tracker; None takes that of touched landmarks.
        fan: the insonified sector, where the scanner's geometry is known.
        fixtures: that act on the tool, and the device that renders them.
        retiming: how the beat is mapped to the model's cycle.
        seed: of a registration's random choices.
    """

    heart: Heart
    calibrations: CalibrationsInUse
    beat_source: BeatSource
    start: Rigid | None = None
    fan: Fan | None = None
    fixtures: FixtureSet = FORBIDDEN_SURFACE
    retiming: RetimeMode = "two-segment"
    seed: int = 0

    @property
    def device(self) -> DeviceLimits:
        """What the haptic device can render."""
        return self.fixtures.device
