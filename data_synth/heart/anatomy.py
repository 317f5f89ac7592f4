"""The contract every synthetic heart fulfils, and the closed-form phantom that fulfils it."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dvf_ig.core import FloatArray, IntArray, Landmarks, Points, Rigid, read_only_arrays

from .anatomical_points import TOUCHABLE, heart_landmarks, with_box_grid
from .mismatch import SmoothField, random_mismatch, tabulated_inverse
from .motion import ES_FRACTION, MotionPreset, PullBack, preset_scale
from .outline import outline, project_to_outline
from .phantom_motion import PhantomMotion
from .reference import Layers, ReferenceMap, build_reference, tissue_at
from .shapes import HeartShape, heart_shape, outside_layers
from .tissue import Tissue

RR_S = 0.86
"""RR interval of the phantom's pre-operative acquisition (about 70 per minute)."""

REFERENCE_SPACING_MM = 1.25
MARGIN_MM = 32.0


class BeatingAnatomy(Protocol):
    """One beating heart: the anatomy that the intervention meets.

    Frame "mr" throughout. `model_phase`: fraction of the pre-operative cycle, cyclic; 0 is end-diastole.

    Attributes:
        rr_s: RR interval of the pre-operative acquisition.
        es_fraction: end-systole as a fraction of that cycle.
        box_mm: (2, 3) heart box.
        surface_triangles: (m, 3) of the epicardial surface, outward, watertight.
        reference: tissue fields at end-diastole.
        inverse_motion: intra-operative position to reference position (motion and mismatch).
    """

    @property
    def rr_s(self) -> float: ...
    @property
    def es_fraction(self) -> float: ...
    @property
    def box_mm(self) -> FloatArray: ...
    @property
    def surface_triangles(self) -> IntArray: ...
    @property
    def reference(self) -> ReferenceMap: ...
    @property
    def inverse_motion(self) -> PullBack: ...

    def tissue(self, xyz_mm: FloatArray, model_phase: float) -> NDArray[np.uint8]:
        """(n,) tissue codes of the intra-operative anatomy at (n, 3) points."""
        ...

    def material(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        """(n, 3) reference positions X = χ⁻¹(x) that scatterers ride on."""
        ...

    def surface_vertices(self, model_phase: float) -> FloatArray:
        """(v, 3) true epicardial surface of the intra-operative anatomy."""
        ...

    def targets(self) -> Landmarks:
        """Named points and a 27-point grid of the heart box at which registration errors are declared."""
        ...

    def landmarks(self) -> Landmarks:
        """Points on the pre-operative end-diastolic surface that a stylus could touch."""
        ...


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PhantomShapes:
    """The heart's implicit shapes and its neighbours, in frame "mr"."""

    heart: HeartShape
    mr_from_heart: Rigid
    center_mm: FloatArray
    base: Tissue = Tissue.ATRIAL_WALL

    def _local(self, xyz_mm: FloatArray) -> FloatArray:
        return (xyz_mm - self.mr_from_heart.translation_mm) @ self.mr_from_heart.rotation

    def organ(self, xyz_mm: FloatArray) -> FloatArray:
        return self.heart.organ(self._local(xyz_mm))

    def inside(self, xyz_mm: FloatArray, organ: FloatArray) -> Layers:
        return self.heart.inside(self._local(xyz_mm), organ)

    def inside_ultrasound_only(self, xyz_mm: FloatArray) -> Layers:
        return self.heart.inside_ultrasound_only(self._local(xyz_mm))

    def outside(self, xyz_mm: FloatArray, organ: FloatArray) -> Layers:
        return outside_layers(xyz_mm - self.center_mm, organ)


@read_only_arrays
@dataclass(frozen=True, eq=False)
class PhantomAnatomy:
    """A four-chamber heart whose motion is known everywhere (see `kernels.lv` and `kernels.flow`).

    The wall of the left ventricle moves exactly incompressibly; right ventricle, atria and great vessels ride
    on the extension of that map after a smooth flow, which empties the right ventricle and fills the atria.

    Attributes:
        shapes: implicit shapes at end-diastole.
        scale: factor on the activation.
        mismatch: pre-operative to intra-operative difference.
        seed: what it was drawn from.
    """

    shapes: PhantomShapes
    scale: float
    mismatch: SmoothField
    ed_vertices_mm: FloatArray
    triangles: IntArray
    seed: int
    rr_s: float = RR_S
    es_fraction: float = ES_FRACTION

    @property
    def box_mm(self) -> FloatArray:
        return np.array([self.ed_vertices_mm.min(axis=0), self.ed_vertices_mm.max(axis=0)])

    @property
    def surface_triangles(self) -> IntArray:
        return self.triangles

    @cached_property
    def reference(self) -> ReferenceMap:
        return build_reference(self.shapes, self._wide_box(), REFERENCE_SPACING_MM)

    @cached_property
    def resting_motion(self) -> PhantomMotion:
        """χ of the pre-operative anatomy."""
        return PhantomMotion(self.shapes.mr_from_heart, self.shapes.heart.lobes(), self.scale)

    @cached_property
    def inverse_motion(self) -> PhantomMotion:
        """χ of the intra-operative anatomy."""
        if self.mismatch.rms_mm == 0:
            return self.resting_motion
        return replace(self.resting_motion, mismatch=tabulated_inverse(self.mismatch, self._wide_box()))

    def deformed(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        """χ: (n, 3) positions at a phase of (n, 3) reference points, without mismatch."""
        return self.resting_motion.push_forward(xyz_mm, model_phase)

    def material(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        return self.inverse_motion.pull_back(xyz_mm, model_phase)

    def tissue(self, xyz_mm: FloatArray, model_phase: float) -> NDArray[np.uint8]:
        return tissue_at(self.shapes, self.material(xyz_mm, model_phase))

    def surface_vertices(self, model_phase: float) -> FloatArray:
        return self.mismatch.forward(self.deformed(self.ed_vertices_mm, model_phase))

    def targets(self) -> Landmarks:
        names, points = heart_landmarks(self.shapes.heart, self.shapes.mr_from_heart)
        return with_box_grid("mr", names, points, self.box_mm)

    def landmarks(self) -> Landmarks:
        names, points = heart_landmarks(self.shapes.heart, self.shapes.mr_from_heart)
        chosen = points[[names.index(name) for name in TOUCHABLE]]
        return Landmarks(TOUCHABLE, Points("mr", project_to_outline(self.shapes.organ, chosen)))

    def _wide_box(self) -> FloatArray:
        return np.asarray(self.box_mm + np.array([[-MARGIN_MM], [MARGIN_MM]]))


def phantom_anatomy(*, motion: MotionPreset, mismatch_mm: float, seed: int) -> PhantomAnatomy:
    """The four-chamber phantom.

    Args:
        motion: "paper5mm" (largest epicardial motion 4.96 mm) or "physiological" (13.9 mm).
        mismatch_mm: RMS over the heart box of the smooth non-rigid difference to the pre-operative anatomy.
        seed: draws shape, place and mismatch; the same seed gives the same heart for either motion.
    Raises:
        InvalidInputError: unknown motion, or a mismatch outside 0 … 8 mm.
    """
    scale = preset_scale(motion)
    shape_seed, place_seed, mismatch_seed = np.random.SeedSequence([seed, 0x4EA7]).spawn(3)
    shape = heart_shape(np.random.default_rng(shape_seed))
    pose = _place_in_thorax(np.random.default_rng(place_seed))
    shapes = PhantomShapes(shape, pose, pose.apply_array(np.array([6.0, 2.0, 68.0])))
    vertices, triangles = outline(shapes.organ, shapes.center_mm)
    box = np.array([vertices.min(axis=0), vertices.max(axis=0)])
    field = random_mismatch(box, mismatch_mm, np.random.default_rng(mismatch_seed))
    return PhantomAnatomy(shapes, scale, field, vertices, triangles, seed)


def _place_in_thorax(rng: np.random.Generator) -> Rigid:
    """mr_from_heart: apex to the left, front and below (LPS); a few degrees and mm vary with the heart."""
    z = np.array([-0.65, 0.55, 0.52])
    z /= np.linalg.norm(z)
    x = np.array([-0.63, -0.77, 0.03])
    x -= (x @ z) * z
    x /= np.linalg.norm(x)
    base = np.column_stack([x, np.cross(z, x), z])
    turn = Rotation.from_rotvec(np.deg2rad(rng.uniform(-8, 8, 3))).as_matrix()
    shift = np.array([62.0, -71.0, -38.0]) + rng.uniform(-12, 12, 3)
    return Rigid("mr", "heart", turn @ base, shift)
