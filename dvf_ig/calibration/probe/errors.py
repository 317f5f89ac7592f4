"""Errors of an image calibration over the frames of a recording."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dvf_ig.core import ErrorSummary, FloatArray, read_only_arrays, summarise_errors


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
