"""Labels of the model in the ultrasound planes at the registered pose, against those of the true pose."""

from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, ImageMap, IntArray, Warp, nearest_phase
from dvf_ig.replay.engine import Replay
from dvf_ig.session import GatedFrames, RegistrationRecord

FRAMES, STEP_PX = 12, 4
"""Frames compared, evenly spread over those used, and every few pixels of them."""


def last_shown(replay: Replay) -> RegistrationRecord | None:
    """Find the last registration in use, or the last that gave a pose at all."""
    attempt = next((a for a in reversed(replay.attempts) if a.usable), None)
    return attempt or next((a for a in reversed(replay.attempts) if a.result), None)


def change_of_shape(attempt: RegistrationRecord) -> Warp | None:
    """Return the change of shape that a registration follows."""
    shape = None if attempt.result is None else attempt.result.shape
    return None if shape is None else shape.followed


def label_fields(replay: Replay) -> dict[str, Any] | None:
    """Compute Dice of each label in the planes of the last registration that is shown.

    The truth is the pre-operative label image of the nearest phase at the true pose, image calibration and
    phase, without the difference of shape between MR and operation. None without labels of every phase, or
    without a registration.
    """
    truth, series, tissue = replay.scenario.truth, replay.scenario.preop.labels, replay.heart.model.tissue
    images, attempt = replay.scenario.ultrasound.images, last_shown(replay)
    if truth is None or series is None or tissue is None or images is None or attempt is None:
        return None
    if attempt.result is None or attempt.frames is None or len(attempt.frames.used) == 0:
        return None
    frames, timing = attempt.frames, replay.heart.model.timing
    warp, shape = change_of_shape(attempt), (images.shape[1], images.shape[2])
    if warp is not None:
        tissue = tissue.contracting(warp.contraction)
    estimated: list[IntArray] = []
    true: list[IntArray] = []
    chosen = np.linspace(0, len(frames.used) - 1, FRAMES).astype(int)
    for frame in np.unique(frames.used[chosen]).tolist():
        at_s = float(frames.event_s[frame])
        there = attempt.result.target_from_source.apply_array(
            _in_tracker(frames, frame, replay.setup.calibrations.probe_from_image, shape)
        )
        if warp is not None:
            there = warp.model_places(there)
        estimated.append(tissue.label_at(there, float(frames.model_phase[frame]), timing))
        really = truth.mr_from_tracker_at(at_s).apply_array(
            _in_tracker(frames, frame, truth.probe_from_image_at(at_s), shape)
        )
        phase = truth.tool.model_phase[np.abs(truth.tool.t_s - at_s).argmin()]
        nearest = int(nearest_phase(series.timing.fractions, np.array([phase]))[0])
        index = series.grid.to_index(really)
        values = series.values[nearest][series.grid.nearest(index)]
        true.append(np.where(series.grid.holds(index, 0.5), values, 0).astype(np.int64))
    return _dice(np.concatenate(estimated), np.concatenate(true), len(estimated), tissue.name)


def _in_tracker(
    frames: GatedFrames, frame: int, probe_from_image: ImageMap, shape: tuple[int, int]
) -> FloatArray:
    """Place (n, 3) pixels of a frame, one of STEP_PX along each side, in the tracker's frame."""
    row, column = np.meshgrid(*(np.arange(0.0, n, STEP_PX) for n in shape), indexing="ij")
    pixels = np.stack([column.ravel(), row.ravel(), np.ones(row.size)], axis=1)
    in_probe = pixels @ probe_from_image.matrix[:3, [0, 1, 3]].T
    return np.asarray(in_probe @ frames.rotations[frame].T + frames.translations_mm[frame])


def _dice(estimated: IntArray, true: IntArray, frames: int, name: Any) -> dict[str, Any]:
    """Compute Dice by label and of the whole organ."""

    def of(a: Any, b: Any) -> float:
        return float(2.0 * (a & b).sum() / max(1, a.sum() + b.sum()))

    values = [value for value in np.unique(true).tolist() if value != 0]
    each = {name(value): of(estimated == value, true == value) for value in values}
    return {
        "mean": float(np.mean(list(each.values()))) if each else None,
        "organ": of(estimated != 0, true != 0),
        "by_label": each,
        "frames": frames,
    }
