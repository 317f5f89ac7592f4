"""Calibrations of probe, latency and tool: each from its recording, or as a file gave it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.calibration import LatencyResult, PointTarget, TargetResult, calibrate_crosswire, estimate_latency
from dvf_ig.calibration.pivot.pivot import PivotResult, calibrate_pivot
from dvf_ig.calibration.probe.nwire import NWireResult, compare_nwire_methods
from dvf_ig.calibration.probe.wall import PlaneTarget, calibrate_wall
from dvf_ig.calibration.refusal import accepted
from dvf_ig.core import ImageMap, LatencyRecording, NWireRecording, PoseStream, Scenario, TargetRecording
from dvf_ig.core.errors import DvfIgError, InvalidInputError
from dvf_ig.core.space.points import Points
from dvf_ig.session import CalibrationsInUse, UltrasoundCalibration

from .parts import CalibrationSources

ProbeResult = NWireResult | TargetResult[PointTarget] | TargetResult[PlaneTarget]


@dataclass(frozen=True, slots=True)
class Calibrations:
    """Calibrations in use, and the evidence of those that were made from a recording.

    Attributes:
        ultrasound: image and latency.
        tip: tool tip in frame "tool"; None if neither a recording nor a file gives it.
        pivot, probe, latency: results with their evidence; None if a file gave the calibration.
    """

    ultrasound: UltrasoundCalibration
    tip: Points | None
    pivot: PivotResult | None
    probe: ProbeResult | None
    latency: LatencyResult | None

    @property
    def in_use(self) -> CalibrationsInUse:
        """All three together.

        Raises:
            InvalidInputError: the tool tip is not known.
        """
        if self.tip is None:
            raise InvalidInputError(
                "the tool tip is not known; give a pivot recording, or the file that calibrate pivot wrote"
            )
        return CalibrationsInUse(self.ultrasound.probe_from_image, self.ultrasound.lag_s, self.tip)


def calibrate(scenario: Scenario | CalibrationSources, seed: int) -> Calibrations:
    """Calibrate tool, probe and latency from what was recorded, exactly as `dvf-ig calibrate` does.

    Refusals are the methods' own.
    """
    tip, pivot = _tip(scenario.tip, np.random.default_rng(seed))
    image, probe = _image(scenario.probe, np.random.default_rng(seed))
    lag_s, latency = _lag(scenario.latency)
    return Calibrations(UltrasoundCalibration(image, lag_s), tip, pivot, probe, latency)


def calibrated(scenario: Scenario, result: Calibrations) -> Scenario:
    """Replace the recordings of calibrations in a scenario by their results."""
    image, lag_s = result.ultrasound.probe_from_image, result.ultrasound.lag_s
    return replace(scenario, probe=image, latency=lag_s, tip=result.tip)


def _tip(
    given: PoseStream | Points | None, rng: np.random.Generator
) -> tuple[Points | None, PivotResult | None]:
    if not isinstance(given, PoseStream):
        return given, None
    with _naming("pivot calibration"):
        result = accepted(calibrate_pivot(given, rng=rng))
    return result.tip, result


def _image(
    given: NWireRecording | TargetRecording | ImageMap, rng: np.random.Generator
) -> tuple[ImageMap, ProbeResult | None]:
    if isinstance(given, ImageMap):
        return given, None
    result: ProbeResult
    with _naming("probe calibration"):
        if isinstance(given, NWireRecording):
            result = accepted(compare_nwire_methods(given, rng=rng).best)
        elif given.phantom == "cross-wire":
            result = accepted(calibrate_crosswire(given.poses, given.points_px, rng=rng))
        else:
            result = accepted(calibrate_wall(given.poses, given.points_px, rng=rng))
    return result.probe_from_image, result


def _lag(given: LatencyRecording | float) -> tuple[float, LatencyResult | None]:
    if isinstance(given, float):
        return given, None
    with _naming("latency calibration"):
        result = accepted(estimate_latency(given))
    return result.lag_s, result


@contextmanager
def _naming(stage: str) -> Iterator[None]:
    """Say which calibration refused its recording."""
    try:
        yield
    except DvfIgError as error:
        raise type(error)(f"{stage}: {error}") from error
