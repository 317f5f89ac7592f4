"""Pre-operative heart of the second world: shapes at end-diastole, and a motion of any strength."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from data_synth.heart.anatomy import phantom_anatomy
from data_synth.heart.beating_anatomy import MARGIN_MM
from data_synth.heart.heart_spec import HeartKind, HeartSpec
from data_synth.heart.motion import HeartMotion, MotionPreset
from data_synth.heart.reference import ReferenceShapes
from dvf_ig.core import FloatArray, IntArray, Landmarks, Rigid, read_only_arrays


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RestingHeart:
    """Pre-operative heart, frame "mr".

    Attributes:
        name: name of the heart.
        shapes: implicit shapes at end-diastole.
        contracting: its motion with a factor on the contraction; 1 is the pre-operative one.
        ed_vertices_mm, triangles: (v, 3), (m, 3) epicardial surface at end-diastole.
        mr_from_heart: frame of its shapes.
        long_axis_mm: (2, 3) epicardial apex of the left ventricle and middle of its base.
        rr_s, es_fraction: timing of its motion.
        targets, landmarks: points at which errors are stated, and those that a stylus could touch.
    """

    name: str
    shapes: ReferenceShapes
    contracting: Callable[[float], HeartMotion]
    ed_vertices_mm: FloatArray
    triangles: IntArray
    mr_from_heart: Rigid
    long_axis_mm: FloatArray
    rr_s: float
    es_fraction: float
    targets: Landmarks
    landmarks: Landmarks

    @property
    def resting_motion(self) -> HeartMotion:
        """Its motion before the intervention."""
        return self.contracting(1.0)

    @property
    def box_mm(self) -> FloatArray:
        """(2, 3) heart box."""
        return box_of(self.ed_vertices_mm)

    @property
    def wide_box_mm(self) -> FloatArray:
        """Box (2, 3) that includes the heart's surroundings."""
        return box_of(self.ed_vertices_mm, MARGIN_MM)


def box_of(points_mm: FloatArray, margin_mm: float = 0.0) -> FloatArray:
    """Compute the (2, 3) lower and upper corner."""
    return np.stack([points_mm.min(axis=0) - margin_mm, points_mm.max(axis=0) + margin_mm])


def four_chamber_heart(motion: MotionPreset, seed: int, kind: HeartKind) -> RestingHeart:
    """Build the four-chamber phantom as the anatomy of this world."""
    heart = phantom_anatomy(motion=motion, mismatch_mm=0.0, seed=seed, heart=HeartSpec(kind))
    resting = heart.resting_motion

    def contracting(factor: float) -> HeartMotion:
        return replace(resting, scale=resting.scale * factor)

    return RestingHeart(
        f"{kind} four-chamber phantom {seed}",
        heart.shapes,
        contracting,
        heart.ed_vertices_mm,
        heart.triangles,
        heart.mr_from_heart,
        heart.long_axis_mm,
        heart.rr_s,
        heart.es_fraction,
        heart.targets(),
        heart.landmarks(),
    )
