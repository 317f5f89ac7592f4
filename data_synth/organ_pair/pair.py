"""Pair of organ images with its truth: the pose, and landmarks moved a little by a smooth shift."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray, Rigid, Volume, read_only_arrays

from .brain import brain_labels
from .cine import heart_labels
from .fields import sampled, smooth_field
from .mr import mr_images
from .organ import OrganLabels
from .ultrasound import ScanStyle, organ_ultrasound, scan_style

LANDMARKS = 24


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class OrganPair:
    """Pair of images of one organ.

    Attributes:
        fixed: 3-D ultrasound, 0 outside the insonified part.
        moving: MR images by contrast, on grids of their own in one frame.
        moving_from_fixed: the rigid map nearest to the truth at the landmarks.
        fixed_mm, moving_mm: (n, 3) landmarks in each image.
    """

    fixed: Volume
    moving: dict[str, Volume]
    moving_from_fixed: Rigid
    fixed_mm: FloatArray
    moving_mm: FloatArray

    def error_mm(self, moving_from_fixed: Rigid) -> float:
        """Compute the mean distance of the landmarks, including the part that no rigid map removes."""
        off = moving_from_fixed.apply_array(self.fixed_mm) - self.moving_mm
        return float(np.linalg.norm(off, axis=1).mean())


def organ_pair(seed: int) -> OrganPair:
    """Simulate ultrasound and MR of a brain; the seed varies anatomy, contrasts, scanner, shift, speckle."""
    organ = brain_labels(seed)
    return _pair(organ, mr_images(organ, seed), scan_style(seed), seed)


def cine_pair(mr: Volume, seed: int) -> OrganPair:
    """Pair real MR of a heart at one time of its cycle with simulated ultrasound (see `cine`).

    Args:
        mr: frame "moving"; slices along the last axis.
        seed: seed of acoustics, scanner, view, shift and speckle.
    """
    rng = child_rng(seed, "organ stack")
    # the insonified part is within a stack of 60 mm
    style = replace(scan_style(seed), depth_mm=rng.uniform(55, 72), sweep_deg=rng.uniform(15, 21))
    return _pair(heart_labels(mr, style.depth_mm, seed), {"cine": mr}, style, seed)


def _pair(organ: OrganLabels, moving: dict[str, Volume], style: ScanStyle, seed: int) -> OrganPair:
    rng = child_rng(seed, "organ pose")
    pose = Rigid.from_rotation_vector(rng.normal(0, 0.4, 3), rng.normal(0, 30.0, 3), "moving", "fixed")
    size_mm, length_mm = rng.uniform(0.5, 2.0), rng.uniform(60.0, 140.0)
    shift_mm = np.stack([smooth_field(organ.grid, length_mm, rng) for _ in range(3)], axis=-1)
    shift_mm *= size_mm / np.sqrt(3.0)
    fixed = organ_ultrasound(organ, shift_mm, pose, style, seed)
    fixed_mm = _landmarks(fixed, rng)
    moving_mm = pose.apply_array(fixed_mm)
    moving_mm = moving_mm + np.stack(
        [sampled(shift_mm[..., k], organ.grid, moving_mm) for k in range(3)], axis=-1
    )
    return OrganPair(fixed, moving, _nearest_rigid(fixed_mm, moving_mm), fixed_mm, moving_mm)


def _landmarks(fixed: Volume, rng: np.random.Generator) -> FloatArray:
    """Spread (LANDMARKS, 3) mm over the insonified part."""
    index = np.argwhere(fixed.values[::4, ::4, ::4] > 0) * 4
    return fixed.grid.to_mm(index[rng.choice(len(index), LANDMARKS, replace=False)].astype(np.float64))


def _nearest_rigid(fixed_mm: FloatArray, moving_mm: FloatArray) -> Rigid:
    fixed_middle, moving_middle = fixed_mm.mean(axis=0), moving_mm.mean(axis=0)
    turn, _ = Rotation.align_vectors(moving_mm - moving_middle, fixed_mm - fixed_middle)
    rotation = turn.as_matrix()
    return Rigid("moving", "fixed", rotation, moving_middle - rotation @ fixed_middle)


def displaced_start(pair: OrganPair, start_mm: float, rng: np.random.Generator) -> Rigid:
    """Draw a pose of that mean distance at the landmarks: random axis, direction and share of rotation."""
    shift, turn = rng.normal(size=3), rng.normal(size=3)
    center = pair.moving_mm.mean(axis=0)
    share = rng.uniform(0.1, 0.8)
    turn *= share / 30.0 / np.linalg.norm(turn)
    shift *= (1 - share) / np.linalg.norm(shift)
    truth, size = pair.moving_from_fixed, start_mm
    at = truth.apply_array(pair.fixed_mm)
    for _ in range(5):
        start = truth.perturbed_left(size * turn, size * shift, center)
        size *= start_mm / float(np.linalg.norm(start.apply_array(pair.fixed_mm) - at, axis=1).mean())
    return truth.perturbed_left(size * turn, size * shift, center)
