"""The two model channels that ultrasound is explained by, one pair of volumes a cardiac phase."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import (
    AnyArray,
    FloatArray,
    Grid,
    IntArray,
    InvalidInputError,
    VolumeSeries,
    nearest_phase,
    read_only_arrays,
)

WALL, BLOOD = 1, 2
"""Values of a label map made from surfaces."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ModelChannels:
    """Two volumes per phase, by which LC2 explains the ultrasound.

    Attributes:
        grid: where the volumes lie, frame "mr".
        values: (n, nx, ny, nz, 2) float32, each channel scaled to zero mean and unit variance.
        fractions: (n,) when in the cycle each volume was taken; (0,) for a still image.
    """

    grid: Grid
    values: NDArray[np.float32]
    fractions: FloatArray

    def nearest_phase(self, model_phase: FloatArray) -> IntArray:
        """(s,) index of the volume nearest in the cycle to each model phase."""
        return nearest_phase(self.fractions, model_phase)


def channels_from_mr(
    mr: VolumeSeries, *, smoothing_mm: float, phases: Sequence[int] | None = None
) -> ModelChannels:
    """MR intensity and its gradient magnitude, smoothed to what the slices resolve.

    Args:
        phases: numbers of the phases that slices will be compared with; all without.
    """
    chosen = list(range(len(mr.timing))) if phases is None else list(phases)
    return _intensity_channels(mr.grid, mr.values[chosen], mr.timing.fractions[chosen], smoothing_mm)


def _intensity_channels(
    grid: Grid, values: AnyArray, fractions: FloatArray, smoothing_mm: float
) -> ModelChannels:
    sigma = [0.0, *(smoothing_mm / grid.spacing_mm)]
    smooth = ndimage.gaussian_filter(values.astype(np.float32), sigma, mode="nearest")
    return ModelChannels(grid, _stacked(smooth, _gradient_magnitude(smooth, grid)), fractions)


def _gradient_magnitude(smooth: NDArray[np.float32], grid: Grid) -> NDArray[np.float32]:
    """Gradient magnitude per mm of each of (n, nx, ny, nz) volumes."""
    squares = np.zeros_like(smooth)
    for axis, step in enumerate(grid.spacing_mm, start=1):
        squares += np.square(np.gradient(smooth, float(step), axis=axis))
    return np.asarray(np.sqrt(squares), dtype=np.float32)


def channels_from_labels(labels: VolumeSeries, *, smoothing_mm: float) -> ModelChannels:
    """Soft blood map and outline of the heart, from a label series (0 outside, 1 wall, 2 blood).

    Ultrasound shows blood dark and the heart's outline bright, where wall and what lies beyond it look the
    same. Where no blood is labelled, the heart itself takes its place.

    Raises:
        InvalidInputError: nothing is labelled.
    """
    if not labels.values.any():
        raise InvalidInputError("the label map is empty; needed labels 1 (wall) and 2 (blood)")
    sigma = [0.0, *(smoothing_mm / labels.grid.spacing_mm)]
    seen = BLOOD if (labels.values == BLOOD).any() else WALL
    blood, heart = (
        ndimage.gaussian_filter(part.astype(np.float32), sigma, mode="nearest")
        for part in (labels.values == seen, labels.values != 0)
    )
    return ModelChannels(
        labels.grid, _stacked(blood, _gradient_magnitude(heart, labels.grid)), labels.timing.fractions
    )


def _stacked(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.float32]:
    out = np.empty((*first.shape, 2), dtype=np.float32)
    for i, channel in enumerate((first, second)):
        out[..., i] = (channel - channel.mean()) / max(float(channel.std()), 1e-12)
    return out
