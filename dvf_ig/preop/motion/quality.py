"""Quality of an estimated motion: similarity, folding, closure error of the cycle, overlap with labels."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dvf_ig.core import AnyArray, BoolArray, FloatArray, InvalidInputError, VolumeSeries, read_only_arrays

from .cycle import CycleMotion
from .free_form import volume_ratio


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class MotionQuality:
    """Evidence for a motion, phase by phase.

    Attributes:
        correlation_before, correlation: (n,) of grey levels around the organ with end-diastole, before and
            after the motion is applied.
        residual: (n,) RMS residual, as a share of the standard deviation of the grey levels.
        min_jacobian: (n,) smallest Jacobian determinant around the organ; at or below 0 the motion folds.
        folded_share: (n,) share of voxels in which it folds.
        dice_before, dice: (n,) overlap of the organ with the labels of that phase; None without labels.
        mean_motion_mm, max_motion_mm: (n,) length of the displacement within the organ.
        meeting_phase: phase at which both chains of registrations meet.
        closure_mean_mm, closure_p95_mm: distance, over the organ, between the displacements of both chains
            there.
        slice_pitch_mm: distance between slices if the image is a stack of distant ones, else None.
    """

    correlation_before: FloatArray
    correlation: FloatArray
    residual: FloatArray
    min_jacobian: FloatArray
    folded_share: FloatArray
    dice_before: FloatArray | None
    dice: FloatArray | None
    mean_motion_mm: FloatArray
    max_motion_mm: FloatArray
    meeting_phase: int
    closure_mean_mm: float
    closure_p95_mm: float
    slice_pitch_mm: float | None

    @property
    def folds(self) -> bool:
        return bool((self.folded_share > 0.0).any())


def assess_motion(
    motion: CycleMotion, image: VolumeSeries, organ: BoolArray, truth: BoolArray | None = None
) -> MotionQuality:
    """Assess a motion on the image from which it was estimated.

    Args:
        organ: (nx, ny, nz) organ at end-diastole.
        truth: (n, nx, ny, nz) organ in every phase, labelled independently.
    Raises:
        InvalidInputError: labels of another shape.
    """
    if truth is not None and truth.shape != image.values.shape:
        raise InvalidInputError(
            f"the labels are {truth.shape}, the image {image.values.shape}; they must agree"
        )
    inside = np.asarray(motion.cropped(organ))
    rows = [
        _phase_row(motion, image, inside, phase, None if truth is None else truth[phase])
        for phase in range(len(motion.deformations))
    ]
    table = np.array(rows).T
    difference = motion.deformations[motion.meeting_phase].on_voxels() - motion.meeting.on_voxels()
    apart = np.linalg.norm(difference[inside], axis=-1)
    labelled = truth is not None
    return MotionQuality(
        table[0],
        table[1],
        table[2],
        table[3],
        table[4],
        table[5] if labelled else None,
        table[6] if labelled else None,
        table[7],
        table[8],
        motion.meeting_phase,
        float(apart.mean()),
        float(np.percentile(apart, 95)),
        None if motion.observable.all() else float(motion.grid.spacing_mm[~motion.observable].max()),
    )


def _phase_row(
    motion: CycleMotion, image: VolumeSeries, inside: BoolArray, phase: int, truth: BoolArray | None
) -> tuple[float, ...]:
    """Compute a phase's entries of MotionQuality, correlation_before to max_motion_mm; NaN without truth."""
    spacing = motion.grid.spacing_mm
    reference = motion.cropped(image.values[motion.ed_phase])[motion.mask].astype(np.float64)
    grey = motion.cropped(image.values[phase]).astype(np.float64)
    moved = motion.deformations[phase].on_voxels()
    at = np.indices(motion.grid.shape) + np.moveaxis(moved / spacing, -1, 0)
    moved_grey = ndimage.map_coordinates(grey, at[:, motion.mask], order=1, mode="nearest")
    after = _correlation(reference, moved_grey)
    ratio = volume_ratio(moved, spacing, motion.mask)
    overlap = (np.nan, np.nan)
    if truth is not None:
        labelled = np.asarray(motion.cropped(truth))
        there = ndimage.map_coordinates(labelled.astype(np.uint8), at, order=0) > 0
        overlap = (dice(inside, labelled), dice(inside, there))
    length = np.linalg.norm(moved[inside], axis=-1)
    return (
        _correlation(reference, grey[motion.mask]),
        after,
        max(0.0, 1.0 - after * after) ** 0.5,
        float(ratio.min()),
        float(np.mean(ratio <= 0.0)),
        *overlap,
        float(length.mean()),
        float(length.max()),
    )


def dice(a: BoolArray, b: BoolArray) -> float:
    """Compute the Dice coefficient 2|A∩B| / (|A| + |B|); 1 if both are empty."""
    total = int(np.count_nonzero(a)) + int(np.count_nonzero(b))
    return 2.0 * int(np.count_nonzero(a & b)) / total if total else 1.0


def _correlation(a: AnyArray, b: AnyArray) -> float:
    a, b = a - a.mean(), b - b.mean()
    power = float((a * a).sum()) * float((b * b).sum())
    return float((a * b).sum()) / power**0.5 if power > 0.0 else 0.0
