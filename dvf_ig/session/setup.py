"""Setup of a session before its first event: patient, calibrations and fixtures."""

from dataclasses import dataclass

from dvf_ig.cardiac import RetimeMode
from dvf_ig.core import Fan, ImageMap, InvalidInputError, Points, Rigid, Signal, TouchedPoints, TriggerTimes
from dvf_ig.core.space.frames import require_same_frame
from dvf_ig.guidance import FORBIDDEN_SURFACE, DeviceLimits, FixtureSet

from .heart import Heart


def require_lag(lag_s: float) -> None:
    """Raise InvalidInputError if a latency of video, s, is beyond a second."""
    if not abs(lag_s) <= 1.0:
        raise InvalidInputError(f"the latency is {lag_s:g} s; needed -1 to 1 s (is it in ms?)")


@dataclass(frozen=True, slots=True, eq=False)
class UltrasoundCalibration:
    """Calibrations that place every pixel of the ultrasound, in space and in time.

    Attributes:
        probe_from_image: image calibration.
        lag_s: t_tracker(event) = t_video + lag_s.
    """

    probe_from_image: ImageMap
    lag_s: float

    def __post_init__(self) -> None:
        require_lag(self.lag_s)


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationsInUse(UltrasoundCalibration):
    """Calibrations of the ultrasound, and of the tool's tip.

    Attributes:
        tip: tool tip, one point in frame "tool".
    """

    tip: Points

    def __post_init__(self) -> None:
        UltrasoundCalibration.__post_init__(self)
        require_same_frame("tool", self.tip.frame, "tool tip of a session")
        if len(self.tip) != 1:
            raise InvalidInputError(f"the tool tip has {len(self.tip)} points; needed one")


@dataclass(frozen=True, slots=True)
class EcgSource:
    """Beats come from an ECG sampled at `rate_hz`."""

    rate_hz: float


@dataclass(frozen=True, slots=True)
class TriggerSource:
    """Beats come from a hardware trigger that fires `delay_s` after the R peak."""

    delay_s: float = 0.0


BeatSource = EcgSource | TriggerSource


def beat_source_of(recorded: Signal | TriggerTimes) -> BeatSource:
    """Return the source of beats that a session needs to know before a recording is pushed."""
    if isinstance(recorded, TriggerTimes):
        return TriggerSource(recorded.delay_s)
    return EcgSource(recorded.rate_hz)


@dataclass(frozen=True, slots=True, eq=False)
class SessionSetup:
    """Patient, calibrations and fixtures of one intervention.

    Attributes:
        heart: the fixture model and what ultrasound is registered to.
        calibrations: tool tip, image and latency.
        beat_source: ECG or trigger, and what is known of it.
        start: coarse mr_from_tracker; None takes that of touched landmarks.
        touched: points touched on the heart's surface before; None without any.
        fan: the insonified sector, where the scanner's geometry is known.
        fixtures: that act on the tool, and the device that renders them.
        retiming: how the beat is mapped to the model's cycle.
        seed: of a registration's random choices.
    """

    heart: Heart
    calibrations: CalibrationsInUse
    beat_source: BeatSource
    start: Rigid | None = None
    touched: TouchedPoints | None = None
    fan: Fan | None = None
    fixtures: FixtureSet = FORBIDDEN_SURFACE
    retiming: RetimeMode = "two-segment"
    seed: int = 0

    @property
    def device(self) -> DeviceLimits:
        """Limits of the haptic device."""
        return self.fixtures.device
