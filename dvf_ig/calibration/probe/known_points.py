"""Gate of a calibration before it is used: its error at points of known position."""

from dvf_ig.calibration.refusal import Gate, Refusal

from .errors import CalibrationErrors

KNOWN_POINT_MM = 1.0
"""Largest mean error (docs/theory/safety.md); the fCal 2.0 recordings of PLUS show 0.54 mm."""


def known_points_refusals(errors: CalibrationErrors) -> tuple[Refusal, ...]:
    """Refuse a calibration by its errors at points it was not fitted to; () if it may be used."""
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
