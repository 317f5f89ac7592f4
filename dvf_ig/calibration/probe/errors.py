"""Errors of an image calibration over the frames of a recording, and the gate on those at known points."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dvf_ig.calibration.refusal import Gate, Refusal
from dvf_ig.core import ErrorSummary, FloatArray, read_only_arrays, summarise_errors

KNOWN_POINT_MM = 1.0
"""Largest mean error (docs/theory/safety.md); the fCal 2.0 recordings of PLUS show 0.54 mm."""
MOVED_RATIO = 2.0
"""A marker that moved on the probe at least doubles the error; that of fCal 2.0 grows by 12 %."""
LITTLE_TURN_DEG = 15.0
"""Sweeps that turn the probe by less leave the image's position in the marker's frame uncertain."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CalibrationErrors:
    """Distances between a phantom's points and where a calibration puts them.

    Attributes:
        summary: of all errors, in mm.
        frames_used: frames with every point seen and a valid pose.
        frames: frames recorded.
        errors_mm: (frames_used,) or (frames_used, points) the errors themselves.
        in_plane_mm: of an N-wire phantom, by wire name, the mean in-plane distance between a wire's dot and
            its predicted crossing; empty for other phantoms.
    """

    summary: ErrorSummary
    frames_used: int
    frames: int
    errors_mm: FloatArray
    in_plane_mm: Mapping[str, float] = field(default_factory=dict)


def calibration_errors(
    errors_mm: FloatArray, frames: int, in_plane_mm: Mapping[str, float] | None = None
) -> CalibrationErrors:
    """Summarise errors (frames_used, …), one row a usable frame, of a recording of `frames`."""
    summary = summarise_errors(errors_mm.ravel())
    return CalibrationErrors(summary, len(errors_mm), frames, np.asarray(errors_mm), in_plane_mm or {})


def known_points_refusals(
    errors: CalibrationErrors,
    *,
    own: CalibrationErrors | None = None,
    turned_deg: float | None = None,
    limit_mm: float = KNOWN_POINT_MM,
) -> tuple[Refusal, ...]:
    """Refuse a calibration by its errors at points it was not fitted to; () if it may be used.

    Args:
        own: errors on the frames it was fitted to, which distinguish a moved marker from a poor calibration.
        turned_deg: largest rotation of the probe in the calibration's sweep.
        limit_mm: the gate, on the mean of the lowest 95 %.
    """
    mean = errors.summary.mean95
    if mean <= limit_mm:
        return ()
    detail = (
        f"known points lie {mean:.2f} mm from where the calibration puts them, above the gate of "
        f"{limit_mm:g} mm (--max-residual-mm moves it)"
    )
    return (Refusal(Gate.RESIDUAL, f"{detail}: {_likely_cause(mean, own, turned_deg)}"),)


def _likely_cause(mean_mm: float, own: CalibrationErrors | None, turned_deg: float | None) -> str:
    if own is None:
        return "the calibration is poor, or the marker has moved on the probe; calibrate again"
    own_mm = own.summary.mean95
    if mean_mm > MOVED_RATIO * own_mm:
        return (
            f"they lie {own_mm:.2f} mm off in the calibration's own frames, so the marker may have moved on "
            "the probe between the two recordings; calibrate again"
        )
    same = f"the calibration's own frames miss by {own_mm:.2f} mm as well, so the marker has not moved"
    if turned_deg is not None and turned_deg < LITTLE_TURN_DEG:
        return (
            f"{same}; its sweep turns the probe by {turned_deg:.1f}° only, which is the likely cause: "
            f"calibrate again and tilt the probe by {LITTLE_TURN_DEG:g}° or more about every axis"
        )
    return f"{same}; check the phantom's wiring, its registration and the tracker's latency"
