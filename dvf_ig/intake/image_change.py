"""How much an ultrasound sequence changes from frame to frame, and how far its probe moved meanwhile."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import BoolArray, FloatArray, ImageMap, PoseStream, TrackedSequence, read_only_arrays

BLOCK_PX = 6
"""Grey levels are averaged over blocks of this size: speckle, which changes with any motion, averages out."""
MOST_FRAMES = 1200
"""More are not read: of a longer recording the first and the last half of as many."""
LONGEST_STEP = 1.8
"""Pairs further apart than this many frame periods have a frame missing between them."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ImageChange:
    """Of (n,) pairs of frames that follow one another, both valid and tracked.

    Attributes:
        t_s: (n,) middle of the pair, video clock.
        change: (n,) mean absolute difference of their grey levels.
        moved_mm: (n,) mean distance by which the probe moved points of the image.
        step_s: usual time between two frames.
    """

    t_s: FloatArray
    change: FloatArray
    moved_mm: FloatArray
    step_s: float


def image_change(
    recorded: TrackedSequence, probe: PoseStream, image: ImageMap, shown: BoolArray
) -> ImageChange:
    """Measure it.

    Args:
        recorded: with images.
        probe: its poses.
        image: probe_from_image.
        shown: (rows, columns) the insonified sector.
    """
    kept = _blocks(shown[None].astype(np.float64))[0] > 0.99
    count, images = len(recorded), recorded.images
    begins = [0] if count <= MOST_FRAMES else [0, count - MOST_FRAMES // 2]
    length = min(count, MOST_FRAMES // len(begins))
    pairs, change = np.empty(0, dtype=np.int64), np.empty(0)
    if images is not None and kept.any():
        parts = [_differences(images[begin : begin + length], kept) for begin in begins]
        pairs = np.concatenate([b + np.arange(len(part)) for b, part in zip(begins, parts, strict=True)])
        change = np.concatenate(parts)
    good = recorded.image_valid & probe.valid
    steps_s = np.diff(recorded.t_s)[pairs]
    step_s = float(np.median(steps_s)) if len(pairs) else np.nan
    used = good[pairs] & good[pairs + 1] & (steps_s < LONGEST_STEP * step_s) & (change > 0)
    first = pairs[used]
    return ImageChange(
        t_s=0.5 * (recorded.t_s[first] + recorded.t_s[first + 1]),
        change=change[used],
        moved_mm=_moved_mm(probe, first, _grid_mm(image, shown.shape)),
        step_s=step_s,
    )


def _blocks(images: NDArray[np.float64]) -> FloatArray:
    """(n, r, c) means over whole blocks."""
    rows, columns = (size // BLOCK_PX for size in images.shape[1:])
    cut = images[:, : rows * BLOCK_PX, : columns * BLOCK_PX]
    return np.asarray(cut.reshape(len(images), rows, BLOCK_PX, columns, BLOCK_PX).mean(axis=(2, 4)))


def _differences(images: NDArray[np.uint8], kept: BoolArray) -> FloatArray:
    """(n − 1,) mean absolute difference of each frame and the next, one frame in memory at a time."""
    out, before = np.empty(max(len(images) - 1, 0)), np.empty(0)
    for i, frame in enumerate(images):
        now = _blocks(frame[None].astype(np.float64))[0][kept]
        if i:
            out[i - 1] = np.abs(now - before).mean()
        before = now
    return out


def _grid_mm(image: ImageMap, shape: tuple[int, ...]) -> FloatArray:
    """(16, 3) points all over the image, frame "probe"."""
    sides = np.meshgrid(np.linspace(0, shape[1], 4), np.linspace(0, shape[0], 4))
    return image.apply_pixels(np.stack(sides, axis=-1).reshape(-1, 2)).xyz_mm


def _moved_mm(probe: PoseStream, first: NDArray[np.int64], points_mm: FloatArray) -> FloatArray:
    turn = probe.rotations[first + 1] - probe.rotations[first]
    shift = probe.translations_mm[first + 1] - probe.translations_mm[first]
    away = np.einsum("nij,pj->npi", turn, points_mm) + shift[:, None]
    return np.asarray(np.linalg.norm(away, axis=2).mean(axis=1))
