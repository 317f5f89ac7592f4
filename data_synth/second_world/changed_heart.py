"""Heart under the probe, whose contraction, load, timing and shape differ from those of the MR.

From the end-diastole of the MR to the intervention: X, volume load L, contraction χ_c at a phase that is late
on one side, mismatch M(φ), and a rigid C that leaves the true pose the best one.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from data_synth.heart.motion import HeartMotion
from data_synth.heart.reference import ReferenceMap
from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray, IntArray, Landmarks, Rigid, read_only_arrays

from .drawn import Drawn
from .random_fields import (
    GridField,
    grid_nodes,
    random_displacement_field,
    solved_inverse,
)
from .resting_heart import RestingHeart, box_of

TABLE_MM = 4.0
TOLERANCE_MM = 2e-4
FIT_PHASES = 16
_LOAD_SMOOTH_MM = 9.0
_FULL_LOAD = 0.35
"""Share of a flat surface's slope at which the load's shift is nearly full."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ChangedMotion:
    """Map between tissue now and at the end-diastole of the MR, both ways; frame "mr".

    The way back is the definition (tables of inverse displacements, cubic between nodes); the way there is
    solved from it to better than 0.01 mm.

    Attributes:
        contraction: χ_c.
        load: inverse of the volume load, end-diastole.
        steady, beating: inverse mismatch: x + steady(x) + cos(2π(φ + turn)) beating(x).
        turn: time of the largest beating part, as a share of the cycle.
        delay: (4,) share of the cycle by which muscle is late: a·(x − c) clipped to ±a₃; (a, a₃).
        center_mm: (3,) heart-box centre c.
        settled: C, mr from mr.
    """

    contraction: HeartMotion
    load: GridField
    steady: GridField
    beating: GridField
    turn: float
    delay: FloatArray
    center_mm: FloatArray
    settled: Rigid

    def pull_back(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        """Compute (n, 3) end-diastolic positions of (n, 3) points, at one phase or each at its own."""
        phase = np.broadcast_to(np.asarray(model_phase, dtype=np.float64), len(xyz_mm))
        x = self.settled.inverse().apply_array(np.ascontiguousarray(xyz_mm, dtype=np.float64))
        z = x + self._mismatch(x, phase)
        late = self.contraction.pull_back(z, (phase - self._late(z)) % 1.0)
        return np.asarray(late + self.load.at(late))

    def surface(self, loaded_mm: FloatArray, model_phase: float) -> FloatArray:
        """Compute (n, 3) positions at a phase of end-diastolic points already moved by the volume load."""
        z = loaded_mm
        for _ in range(8):
            before = z
            z = self.contraction.push_forward(loaded_mm, (model_phase - self._late(before)) % 1.0)
            if np.abs(z - before).max(initial=0.0) < TOLERANCE_MM:
                break
        swing = float(np.cos(2 * np.pi * (model_phase + self.turn)))
        both = self.steady.displacement_mm + swing * self.beating.displacement_mm
        mismatch = GridField(both, self.steady.origin_mm, self.steady.spacing_mm)
        return self.settled.apply_array(solved_inverse(mismatch, z, TOLERANCE_MM))

    def _mismatch(self, x: FloatArray, phase: FloatArray) -> FloatArray:
        swing = np.cos(2 * np.pi * (phase + self.turn))[:, None]
        return np.asarray(self.steady.at(x) + swing * self.beating.at(x))

    def _late(self, z: FloatArray) -> FloatArray:
        most = max(float(self.delay[3]), 1e-12)
        return np.asarray(most * np.tanh((z - self.center_mm) @ self.delay[:3] / most))


@dataclass(frozen=True, eq=False)
class ChangedHeart:
    """Intra-operative heart as a `BeatingAnatomy`.

    Attributes:
        heart: the pre-operative heart.
        reference: its tissue.
        inverse_motion: the change and the beat.
    """

    heart: RestingHeart
    reference: ReferenceMap
    inverse_motion: ChangedMotion

    @property
    def rr_s(self) -> float:
        return self.heart.rr_s

    @property
    def es_fraction(self) -> float:
        return self.heart.es_fraction

    @property
    def box_mm(self) -> FloatArray:
        return self.heart.box_mm

    @property
    def surface_triangles(self) -> IntArray:
        return self.heart.triangles

    @cached_property
    def loaded_vertices_mm(self) -> FloatArray:
        return solved_inverse(self.inverse_motion.load, self.heart.ed_vertices_mm)

    def tissue(self, xyz_mm: FloatArray, model_phase: float) -> NDArray[np.uint8]:
        """Look up (n,) tissue codes at the nearest node of the reference."""
        codes = np.empty(len(xyz_mm), dtype=np.uint8)
        signal = np.empty(len(xyz_mm), dtype=np.float32)
        self.reference.sample(self.material(xyz_mm, model_phase), signal, codes)
        return codes

    def material(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        return self.inverse_motion.pull_back(xyz_mm, model_phase)

    def surface_vertices(self, model_phase: float) -> FloatArray:
        return self.inverse_motion.surface(self.loaded_vertices_mm, model_phase)

    def targets(self) -> Landmarks:
        return self.heart.targets

    def landmarks(self) -> Landmarks:
        return self.heart.landmarks


def changed_heart(heart: RestingHeart, reference: ReferenceMap, drawn: Drawn) -> tuple[ChangedHeart, float]:
    """Draw the heart of the intervention, and the RMS distance of its surface from that of the MR, mm.

    C is the best rigid map of the changed surface onto the pre-operative one over the whole cycle, every
    vertex weighted by its area: the remaining change has no rigid part; the true pose is the best rigid one.
    """
    wide = box_of(heart.box_mm, 40.0)
    center, half = heart.box_mm.mean(axis=0), 0.5 * np.ptp(heart.box_mm, axis=0)
    rng = child_rng(drawn.seed, "second world dyssynchrony side")
    side = rng.standard_normal(3)
    side *= drawn["heart.dyssynchrony"] / np.linalg.norm(side) / half.mean()
    motion = ChangedMotion(
        heart.contracting(1.0 + drawn["heart.contractility"]),
        _load_field(reference, wide, drawn["heart.volume_load_mm"]),
        _mismatch_field(heart, wide, drawn, "mismatch"),
        _mismatch_field(heart, wide, drawn, "mismatch_beating"),
        float(child_rng(drawn.seed, "second world mismatch turn").uniform()),
        np.append(side, 0.5 * drawn["heart.dyssynchrony"]),
        center,
        Rigid.identity("mr", "mr"),
    )
    settled, rms_mm = _settled(heart, motion)
    return ChangedHeart(heart, reference, settled), rms_mm


def _settled(heart: RestingHeart, motion: ChangedMotion) -> tuple[ChangedMotion, float]:
    """Find C; return the motion with it and the remaining RMS."""
    before = heart.resting_motion
    loaded = solved_inverse(motion.load, heart.ed_vertices_mm)
    phases = np.arange(FIT_PHASES) / FIT_PHASES
    now = np.concatenate([motion.surface(loaded, p) for p in phases.tolist()])
    then = np.concatenate([before.push_forward(heart.ed_vertices_mm, p) for p in phases.tolist()])
    weights = np.tile(vertex_areas(heart.ed_vertices_mm, heart.triangles), FIT_PHASES)
    best = best_rigid(now, then, "mr", "mr", weights)
    rest = best.apply_array(now) - then
    rms_mm = float(np.sqrt(np.average((rest**2).sum(axis=1), weights=weights)))
    return replace(motion, settled=best), rms_mm


def vertex_areas(vertices_mm: FloatArray, triangles: IntArray) -> FloatArray:
    """Compute (v,) a third of the area of the triangles around each vertex, mm²."""
    a, b, c = (vertices_mm[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    out = np.zeros(len(vertices_mm))
    for k in range(3):
        np.add.at(out, triangles[:, k], area)
    return out


def _mismatch_field(heart: RestingHeart, wide_mm: FloatArray, drawn: Drawn, name: str) -> GridField:
    length = drawn[f"heart.{name}_length_mm"]
    rms = min(drawn[f"heart.{name}_mm"], drawn["heart.mismatch_over_length"] * length)
    rng = child_rng(drawn.seed, f"second world {name} field")
    return random_displacement_field(wide_mm, heart.box_mm, rms, length, TABLE_MM, rng)


def _load_field(reference: ReferenceMap, wide_mm: FloatArray, shift_mm: float) -> GridField:
    """Tabulate the inverse of a shift of the surface along its normal, which moves the walls as well.

    The direction is that towards the border of a smoothed heart; the shift fades deep inside and outside.
    """
    nodes = grid_nodes(wide_mm, TABLE_MM)
    index = np.rint((nodes - reference.origin_mm) / reference.spacing_mm).astype(int)
    shape = np.array(reference.organ_mm.shape)
    inside = ((index >= 0) & (index < shape)).all(axis=-1)
    index = np.clip(index, 0, shape - 1)
    depth = reference.organ_mm[index[..., 0], index[..., 1], index[..., 2]]
    mask = np.where(inside, np.clip(0.5 + depth / TABLE_MM, 0.0, 1.0), 0.0)
    sigma = _LOAD_SMOOTH_MM / TABLE_MM
    slope = np.stack([np.gradient(gaussian_filter(mask, sigma), axis=k) for k in range(3)], axis=-1)
    steepness = np.linalg.norm(slope, axis=-1, keepdims=True)
    flat = 1.0 / (np.sqrt(2.0 * np.pi) * sigma)
    inward = slope / np.maximum(steepness, 1e-9) * np.tanh(steepness / (_FULL_LOAD * flat))
    return GridField(shift_mm * inward, nodes[0, 0, 0], TABLE_MM)


def best_rigid(
    source_mm: FloatArray, target_mm: FloatArray, target: str, source: str, weights: FloatArray | None = None
) -> Rigid:
    """Fit target_from_source to (n, 3) points by least squares.

    Source: Kabsch, Acta Cryst. A32:922, 1976.
    """
    w = np.ones(len(source_mm)) if weights is None else weights
    a, b = np.average(source_mm, axis=0, weights=w), np.average(target_mm, axis=0, weights=w)
    u, _, vt = np.linalg.svd(((source_mm - a) * w[:, None]).T @ (target_mm - b))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u @ flip @ vt).T
    return Rigid(target, source, rotation, b - rotation @ a)
