"""Whether a calibration puts points that are known where they are: the gate before it is used."""

from dvf_ig.calibration.refusal import Gate, Refusal

from .errors import CalibrationErrors

KNOWN_POINT_MM = 1.0
"""Largest mean error (docs/theory/safety.md); the fCal 2.0 recordings of PLUS have 0.54 mm."""


def known_points_refusals(errors: CalibrationErrors) -> tuple[Refusal, ...]:
    """Why a calibration must not be used that was held against points it was not made of; () where it may."""
    mean = errors.summary.mean95
    if mean <= KNOWN_POINT_MM:
        return ()
    return (
        Refusal(
            Gate.RESIDUAL,
            f"known points lie {mean:.2f} mm from where the calibration puts them, needed at most "
            f"{KNOWN_POINT_MM:g} mm: the marker may have moved on the probe; calibrate again",
        ),
    )
