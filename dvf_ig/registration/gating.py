"""Select the ultrasound frames that may be compared with the model, and those that show anatomy at all.

An image must not be dark or a repetition, and must have more structure than speckle. Noise and speckle are
correlated over a few pixels, tissue over centimetres. So the image is averaged over blocks of BLOCK_MM; what
remains after a smooth trend (gain, attenuation) is correlated between blocks of tissue and not between blocks
of noise, whatever their brightness. The statistic is Moran's I, the mean over neighbours one and two blocks
apart.

Source: Moran 1950. Differs from source: residuals of a quadratic trend, and two distances.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import BoolArray, FloatArray, IntArray, phase_distance, read_only_arrays
from dvf_ig.kernels.grid.pool import block_sums

BLOCK_MM = 4.0
"""Edge of the blocks of a frame that are compared with their neighbours."""
MIN_FILL = 0.6
"""Least share of a block inside the sector."""
LIT_GREY = 10
"""Grey level above which a pixel is lit."""
MIN_LIT_SHARE = 0.05
"""A frame in which fewer pixels of the sector are brighter than LIT_GREY is dark. All frames of tuning seeds
101 to 103 show 0.61 or more with poor images, 0.94 or more with calm ones."""
MIN_STRUCTURE = 0.25
"""A frame whose blocks are less correlated is noise. White noise and speckle correlated over up to 3.5 mm
(full width), of any brightness, reach 0.13; all frames of tuning seeds 101 to 103, calm and with poor images,
show 0.45 or more; real scans of a phantom and a tank (Ultrasonix, BK; pitch taken as 0.15 to 0.3 mm) 0.36."""
LEAST_VARIANCE = 0.01
"""Variance of block means, in squared grey levels, below which there is nothing to correlate."""
PHASE_WINDOW = 0.02
"""Largest distance, in fractions of the cycle, between a frame and the model phase it is compared with."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FrameInformation:
    """Content of each of n frames.

    Attributes:
        lit_share: (n,) share of the sector's pixels brighter than LIT_GREY.
        repeated: (n,) the sector is bit-identical to that of the frame before.
        structure: (n,) correlation of neighbouring blocks, about 0 for noise.
    """

    lit_share: FloatArray
    repeated: BoolArray
    structure: FloatArray

    @property
    def dark(self) -> BoolArray:
        return np.asarray(self.lit_share < MIN_LIT_SHARE)

    @property
    def noise(self) -> BoolArray:
        return np.asarray(self.structure < MIN_STRUCTURE)


def frame_information(
    images: NDArray[np.uint8],
    mask: BoolArray,
    pitch_mm: tuple[float, float],
    *,
    before: NDArray[np.uint8] | None = None,
) -> FrameInformation:
    """Measure the content of each of (n, rows, columns) images.

    Args:
        mask: (rows, columns) sector; frames without any are dark.
        pitch_mm: mm a row and mm a column.
        before: (rows, columns) the frame before the first; None without one.
    """
    repeated = _repeated(images, mask, before)
    shape = [size // max(1, round(BLOCK_MM / mm)) for size, mm in zip(mask.shape, pitch_mm, strict=True)]
    if min(shape) == 0 or not mask.any():
        return FrameInformation(np.zeros(len(images)), repeated, np.zeros(len(images)))
    sums, lit = np.empty((len(images), *shape), dtype=np.int64), np.empty(len(images), dtype=np.int64)
    block_sums(images, np.array(mask), LIT_GREY, sums, lit)
    counts = _block_counts(mask, shape)
    high, wide = (size // blocks for size, blocks in zip(mask.shape, shape, strict=True))
    full = counts >= MIN_FILL * high * wide
    means = sums[:, full] / counts[full]
    return FrameInformation(lit / max(int(counts.sum()), 1), repeated, _moran(means, full))


def _block_counts(mask: BoolArray, shape: list[int]) -> IntArray:
    """Pixels of the mask in every block, as `block_sums` cuts them."""
    high, wide = (size // blocks for size, blocks in zip(mask.shape, shape, strict=True))
    cut = mask[: shape[0] * high, : shape[1] * wide].reshape(shape[0], high, shape[1], wide)
    return np.asarray(cut.sum(axis=(1, 3)))


def _repeated(images: NDArray[np.uint8], mask: BoolArray, before: NDArray[np.uint8] | None) -> BoolArray:
    """(n,) frames whose sector equals that of the frame before, the dark ones among them."""
    earlier = [None if len(images) == 0 else before, *images[:-1]]
    return np.array(
        [
            was is not None and not ((was != now) & mask).any()
            for was, now in zip(earlier, images, strict=False)
        ],
        dtype=np.bool_,
    )


def _moran(means: FloatArray, full: BoolArray) -> FloatArray:
    """(n,) mean correlation of blocks one and two apart, after a quadratic trend; 0 where they do not vary.

    Args:
        means: (n, k) of the k blocks that `full` (block rows, block columns) marks.
    """
    row, column = (2.0 * a / max(n - 1, 1) - 1.0 for a, n in zip(np.nonzero(full), full.shape, strict=True))
    trend = np.column_stack([np.ones_like(row), row, column, row * row, row * column, column * column])
    if len(row) <= 2 * trend.shape[1]:
        return np.zeros(len(means))
    smooth, _ = np.linalg.qr(trend)
    rest = np.zeros((len(means), *full.shape))
    rest[:, full] = means - (means @ smooth) @ smooth.T
    variance = (rest * rest).sum(axis=(1, 2)) / len(row)
    correlation = np.zeros(len(means))
    for apart in (1, 2):
        products = np.zeros(len(means))
        pairs = 0
        for a, b, both in (
            (rest[:, apart:], rest[:, :-apart], full[apart:] & full[:-apart]),
            (rest[:, :, apart:], rest[:, :, :-apart], full[:, apart:] & full[:, :-apart]),
        ):
            products += np.einsum("nij,nij->n", a, b)
            pairs += int(both.sum())
        correlation += 0.5 * products / max(pairs, 1)
    return np.where(variance > LEAST_VARIANCE, correlation / np.maximum(variance, LEAST_VARIANCE), 0.0)


class FrameRejection(StrEnum):
    """Why a frame is not compared with the model; each value is what a user reads."""

    INVALID_IMAGE = "image marked invalid"
    DARK_IMAGE = "image dark"
    REPEATED_IMAGE = "image frozen"
    NOISE_IMAGE = "image without structure"
    UNTRACKED_PROBE = "probe not tracked"
    BREATH = "in the moving part of a breath, or before it is known"
    IRREGULAR_BEAT = "irregular or unfinished beat"
    BETWEEN_PHASES = "between model phases"


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Gated:
    """Frames kept, and how many were rejected for each reason (the first that applies).

    Attributes:
        index: (k,) kept frames, in time order.
        rejected: number of frames for each reason.
    """

    index: IntArray
    rejected: dict[FrameRejection, int]


def gate_frames(
    model_phase: FloatArray,
    fractions: FloatArray,
    *,
    image_valid: BoolArray,
    pose_valid: BoolArray,
    beat_valid: BoolArray,
    information: FrameInformation,
    breath_valid: BoolArray | None = None,
    window: float = PHASE_WINDOW,
) -> Gated:
    """Keep frames that show anatomy, with a valid image and pose, a regular beat, and a model phase close by.

    Args:
        model_phase: (n,) retimed phase of each frame, [0, 1).
        fractions: (m,) phases of the model, [0, 1).
        image_valid, pose_valid, beat_valid: (n,).
        information: of the n images.
        breath_valid: (n,) the heart rests, or can be moved to its rest; None if nothing follows the breath.
    """
    near = phase_distance(fractions, model_phase).min(axis=1) <= window
    passed = np.ones(len(model_phase), dtype=np.bool_)
    rejected: dict[FrameRejection, int] = {}
    for reason, good in (
        (FrameRejection.INVALID_IMAGE, image_valid),
        (FrameRejection.DARK_IMAGE, ~information.dark),
        (FrameRejection.REPEATED_IMAGE, ~information.repeated),
        (FrameRejection.NOISE_IMAGE, ~information.noise),
        (FrameRejection.UNTRACKED_PROBE, pose_valid),
        (FrameRejection.BREATH, np.ones_like(passed) if breath_valid is None else breath_valid),
        (FrameRejection.IRREGULAR_BEAT, beat_valid),
        (FrameRejection.BETWEEN_PHASES, near),
    ):
        rejected[reason] = int((passed & ~good).sum())
        passed &= good
    return Gated(np.flatnonzero(passed), rejected)
