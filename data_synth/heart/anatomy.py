"""Four-chamber phantom: the standard heart in closed form, or one person's."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_synth.kernels.lv import BASE, outer_radius
from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray, IntArray, Landmarks, Points, Rigid, read_only_arrays

from .anatomical_points import TOUCHABLE, heart_landmarks, with_box_grid
from .beating_anatomy import MARGIN_MM, REFERENCE_SPACING_MM
from .heart_spec import HeartKind, HeartSeeds, HeartSpec
from .mismatch import TABLE_MM as MISMATCH_TABLE_MM
from .mismatch import (
    UNTOUCHED,
    SmoothField,
    SurgicalChange,
    TabulatedMap,
    random_mismatch,
    surgical_field,
    tabulated,
)
from .motion import (
    ES_FRACTION,
    UNCHANGED_MOTION,
    MotionChange,
    MotionPreset,
    StillRegion,
    preset_scale,
)
from .outline import outline, project_to_outline
from .phantom_motion import PhantomMotion
from .population import PumpFunction, draw_kind, draw_pump_function
from .reference import Layers, ReferenceMap, build_reference, tissue_at
from .shapes import HeartShape, heart_shape, outside_layers
from .tissue import Tissue
from .varied_shape import CENTER_MM, varied_shape
from .warp import TABLE_MM, PlacedWarp

RR_S = 0.86
"""RR interval of the standard heart's pre-operative acquisition (about 70 per minute)."""

TURN_DEG, VARIED_TURN_DEG = 8.0, 14.0
"""Largest turn in the thorax about each axis, of the standard and of other hearts."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PhantomShapes:
    """Implicit shapes of the heart and its neighbours, in frame "mr".

    Depths of a person's heart are those of the standard heart at W⁻¹(x), in the standard heart's mm.

    Attributes:
        heart: shapes in the standard heart's frame.
        mr_from_heart: pose of the heart.
        center_mm: centre of the heart.
        standard: W⁻¹; None: this is the standard heart.
        base: tissue between the parts.
    """

    heart: HeartShape
    mr_from_heart: Rigid
    center_mm: FloatArray
    standard: TabulatedMap | None = None
    base: Tissue = Tissue.ATRIAL_WALL

    def _local(self, xyz_mm: FloatArray) -> FloatArray:
        points = xyz_mm if self.standard is None else self.standard.at(xyz_mm)
        return (points - self.mr_from_heart.translation_mm) @ self.mr_from_heart.rotation

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
    """Four-chamber heart whose motion is known everywhere (see `kernels.lv` and `kernels.flow`).

    In the standard heart the wall of the left ventricle moves exactly incompressibly; right ventricle, atria
    and great vessels ride on the extension of that map after a smooth flow, which empties the right ventricle
    and fills the atria. A person's heart is W(standard heart), with all that moves with it.

    Attributes:
        shapes: implicit shapes at end-diastole.
        scale: factor on the activation during the MR.
        mismatch: pre-operative to intra-operative difference.
        seeds: seeds it was drawn from.
        kind: kind of heart, never "varied".
        pump: pump function; None: that of the standard heart.
        warp: W; None: the standard heart.
        resting: the heart in the MR, whose unchanged parts are shared; None: this one.
        contraction: factor on `scale` since the MR; still: region that stands still since; None: none.
    """

    shapes: PhantomShapes
    scale: float
    mismatch: SmoothField
    ed_vertices_mm: FloatArray
    triangles: IntArray
    seeds: HeartSeeds
    kind: HeartKind = "standard"
    pump: PumpFunction | None = None
    warp: PlacedWarp | None = None
    resting: "PhantomAnatomy | None" = None
    contraction: float = 1.0
    still: StillRegion | None = None

    @property
    def rr_s(self) -> float:
        return RR_S if self.pump is None else self.pump.rr_s

    @property
    def es_fraction(self) -> float:
        return ES_FRACTION if self.pump is None else self.pump.es_fraction

    @property
    def box_mm(self) -> FloatArray:
        return _box(self.ed_vertices_mm)

    @property
    def surface_triangles(self) -> IntArray:
        return self.triangles

    @property
    def mr_from_heart(self) -> Rigid:
        return self.shapes.mr_from_heart

    @cached_property
    def long_axis_mm(self) -> FloatArray:
        """Epicardial apex (2, 3) of the left ventricle and middle of its base at end-diastole."""
        return self.placed(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, BASE]]))

    @cached_property
    def reference(self) -> ReferenceMap:
        if self.resting is not None:
            return self.resting.reference
        return build_reference(self.shapes, _wide(self.box_mm), REFERENCE_SPACING_MM)

    @cached_property
    def resting_motion(self) -> PhantomMotion:
        """Motion χ of the pre-operative anatomy."""
        if self.resting is not None:
            return self.resting.resting_motion
        return self._motion(self.shapes.standard)

    @cached_property
    def present_motion(self) -> PhantomMotion:
        """Motion χ of the intra-operative anatomy, mismatch undone."""
        return replace(self.resting_motion, scale=self.scale * self.contraction, still=self.still)

    @cached_property
    def inverse_motion(self) -> PhantomMotion:
        """Motion χ of the intra-operative anatomy."""
        if self.mismatch.rms_mm == 0:
            return self.present_motion
        spacing_mm = MISMATCH_TABLE_MM if self.warp is None else TABLE_MM
        before = tabulated(self._standard_from_now, _wide(self.box_mm), spacing_mm)
        return replace(self.present_motion, before=before)

    def deformed(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        """Apply χ of the MR: (n, 3) positions at a phase of (n, 3) reference points, without mismatch."""
        return self.resting_motion.push_forward(xyz_mm, model_phase)

    def material(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        return self.inverse_motion.pull_back(xyz_mm, model_phase)

    def tissue(self, xyz_mm: FloatArray, model_phase: float) -> NDArray[np.uint8]:
        return tissue_at(self.shapes, self.material(xyz_mm, model_phase))

    def surface_vertices(self, model_phase: float) -> FloatArray:
        moved = self.present_motion.push_standard(self.standard_vertices_mm, model_phase)
        return self.mismatch.forward(moved)

    def targets(self) -> Landmarks:
        names, points = heart_landmarks(self.shapes.heart)
        return with_box_grid("mr", names, self.placed(points), self.box_mm)

    def landmarks(self) -> Landmarks:
        names, points = heart_landmarks(self.shapes.heart)
        chosen = self.placed(points)[[names.index(name) for name in TOUCHABLE]]
        return Landmarks(TOUCHABLE, Points("mr", project_to_outline(self.shapes.organ, chosen)))

    @cached_property
    def standard_vertices_mm(self) -> FloatArray:
        """Vertices (v, 3) of the outline in the standard heart."""
        return self.ed_vertices_mm if self.warp is None else self.warp.inverse(self.ed_vertices_mm)

    def changed(
        self,
        mismatch_mm: float,
        seed: int,
        surgery: SurgicalChange = UNTOUCHED,
        motion_change: MotionChange = UNCHANGED_MOTION,
    ) -> "PhantomAnatomy":
        """Apply other differences to the heart in the MR, drawn as by `phantom_anatomy`.

        Both share the results computed for the heart in the MR.
        """
        before = self if self.resting is None else self.resting
        seeds = replace(self.seeds, mismatch=seed)
        return _changed_since_mr(before, mismatch_mm, seeds, surgery, motion_change)

    def placed(self, points: FloatArray) -> FloatArray:
        """Map points of the standard heart's frame to (n, 3) positions."""
        standard = self.shapes.mr_from_heart.apply_array(points)
        return standard if self.warp is None else self.warp.forward(standard)

    def _standard_from_now(self, xyz_mm: FloatArray) -> FloatArray:
        before = self.mismatch.inverse(xyz_mm)
        return before if self.warp is None else self.warp.inverse(before)

    def _motion(self, before: TabulatedMap | None) -> PhantomMotion:
        heart, cavity = self.shapes.heart, self.shapes.heart.lv_cavity
        return PhantomMotion(
            self.shapes.mr_from_heart,
            heart.lobes(),
            self.scale,
            cavity if self.pump is None else self.pump.cavity(cavity),
            self.es_fraction,
            self.warp,
            before,
        )


def phantom_anatomy(
    *,
    motion: MotionPreset,
    mismatch_mm: float,
    seed: int,
    heart: HeartSpec | None = None,
    surgery: SurgicalChange = UNTOUCHED,
    motion_change: MotionChange = UNCHANGED_MOTION,
) -> PhantomAnatomy:
    """Draw a four-chamber phantom.

    Args:
        motion: "paper5mm" (largest epicardial motion of the standard heart 4.96 mm) or "physiological"
            (13.9 mm).
        mismatch_mm: RMS over the heart box of the smooth non-rigid difference to the pre-operative anatomy.
        seed: seed of everything that `heart` leaves open; the same seed gives the same heart for either
            motion.
        heart: kind of heart and separate seeds; None is the standard heart.
        surgery: change of shape by surgery, drawn with the mismatch.
        motion_change: change of motion since the MR; a still region is drawn with the mismatch too.
    Raises:
        InvalidInputError: unknown motion, or a mismatch outside 0 … 8 mm.
    """
    spec = heart or HeartSpec()
    seeds = spec.seeds(seed)
    resting = _at_rest(spec.kind, motion, seeds.anatomy, seeds.motion)
    return _changed_since_mr(resting, mismatch_mm, seeds, surgery, motion_change)


def _changed_since_mr(
    resting: PhantomAnatomy,
    mismatch_mm: float,
    seeds: HeartSeeds,
    surgery: SurgicalChange,
    motion_change: MotionChange,
) -> PhantomAnatomy:
    rng = np.random.default_rng(_seed_sequences(seeds.mismatch)[2])
    drawn = surgical_field(resting.ed_vertices_mm, surgery, child_rng(seeds.mismatch, "surgery"))
    field = random_mismatch(resting.box_mm, mismatch_mm, rng, surgery=drawn)
    return replace(
        resting,
        mismatch=field,
        seeds=seeds,
        resting=resting,
        contraction=motion_change.contraction,
        still=_still_region(resting, motion_change.still_mm, child_rng(seeds.mismatch, "still wall")),
    )


def _still_region(resting: PhantomAnatomy, radius_mm: float, rng: np.random.Generator) -> StillRegion | None:
    """Draw a still region about a point half-way up the left ventricle's free wall; radius 0: None."""
    if radius_mm == 0:
        return None
    height, angle = BASE * rng.uniform(0.35, 0.65), np.pi + rng.uniform(-0.6, 0.6)
    radius = outer_radius(height)
    center = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
    return StillRegion(resting.shapes.mr_from_heart.apply_array(center), radius_mm)


@lru_cache(maxsize=2)
def _at_rest(kind: HeartKind, motion: MotionPreset, anatomy_seed: int, motion_seed: int) -> PhantomAnatomy:
    """Build the heart without mismatch, the expensive part that images of one heart share."""
    scale = preset_scale(motion)
    shape_seed, place_seed, _ = _seed_sequences(anatomy_seed)
    place_rng = np.random.default_rng(place_seed)
    seeds = HeartSeeds(anatomy_seed, motion_seed, mismatch=0, speckle=0)
    if kind == "standard":
        shape, pose = heart_shape(np.random.default_rng(shape_seed)), _place_in_thorax(place_rng, TURN_DEG)
        shapes = PhantomShapes(shape, pose, pose.apply_array(CENTER_MM))
        vertices, triangles = outline(shapes.organ, shapes.center_mm)
        return PhantomAnatomy(shapes, scale, _no_mismatch(vertices), vertices, triangles, seeds)
    rng = np.random.default_rng(np.random.SeedSequence([anatomy_seed, 0x5A2E]))
    drawn_kind = draw_kind(kind, rng)
    drawn, pose = varied_shape(drawn_kind, rng), _place_in_thorax(place_rng, VARIED_TURN_DEG)
    center = pose.apply_array(CENTER_MM)
    standard, triangles = outline(PhantomShapes(drawn.heart, pose, center).organ, center)
    warp = PlacedWarp(drawn.warp, pose, _wide(_wide(_box(standard))))
    vertices = warp.forward(standard)
    shapes = PhantomShapes(
        drawn.heart,
        pose,
        warp.forward(center[None])[0],
        tabulated(warp.inverse, _wide(_box(vertices)), TABLE_MM),
    )
    motion_rng = np.random.default_rng(np.random.SeedSequence([motion_seed, 0xBEA7]))
    pump = draw_pump_function(drawn_kind, drawn.heart.lv_cavity, motion_rng)
    scale *= pump.contractility
    none = _no_mismatch(vertices)
    return PhantomAnatomy(shapes, scale, none, vertices, triangles, seeds, drawn_kind, pump, warp)


def _no_mismatch(vertices_mm: FloatArray) -> SmoothField:
    return random_mismatch(_box(vertices_mm), 0.0, np.random.default_rng(0))


def _seed_sequences(seed: int) -> list[np.random.SeedSequence]:
    """Derive the seed sequences of shape, position and mismatch."""
    return np.random.SeedSequence([seed, 0x4EA7]).spawn(3)


def _box(vertices_mm: FloatArray) -> FloatArray:
    return np.array([vertices_mm.min(axis=0), vertices_mm.max(axis=0)])


def _wide(box_mm: FloatArray) -> FloatArray:
    return np.asarray(box_mm + np.array([[-MARGIN_MM], [MARGIN_MM]]))


def _place_in_thorax(rng: np.random.Generator, turn_deg: float) -> Rigid:
    """Draw mr_from_heart: apex left, front and below (LPS); up to `turn_deg` about each axis, and 12 mm."""
    z = np.array([-0.65, 0.55, 0.52])
    z /= np.linalg.norm(z)
    x = np.array([-0.63, -0.77, 0.03])
    x -= (x @ z) * z
    x /= np.linalg.norm(x)
    base = np.column_stack([x, np.cross(z, x), z])
    turn = Rotation.from_rotvec(np.deg2rad(rng.uniform(-turn_deg, turn_deg, 3))).as_matrix()
    shift = np.array([62.0, -71.0, -38.0]) + rng.uniform(-12, 12, 3)
    return Rigid("mr", "heart", turn @ base, shift)
