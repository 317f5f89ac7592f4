"""Measures of a phantom's motion, taken on the motion itself."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_synth.kernels import lv
from dvf_ig.core import FloatArray

from .anatomy import PhantomAnatomy
from .reference import tissue_at
from .tissue import Tissue

VOLUME_STEP_MM = 2.5
DET_STEP_MM = 1e-3
LEFT_ATRIUM = (Tissue.LA_BLOOD, Tissue.LAA_BLOOD)


@dataclass(frozen=True, slots=True)
class MotionReport:
    """Measures of end-systole relative to end-diastole, without mismatch unless stated.

    Attributes:
        lv_ejection_fraction, rv_ejection_fraction: ejection fractions of the blood inside, ∫ det ∇χ over it.
        la_expansion: end-systolic over end-diastolic volume of the left atrium, minus 1.
        wall_thickening: relative thickening of the left ventricle's wall half-way up.
        long_axis_shortening: relative shortening of the distance between epicardial apex and mitral plane.
        largest_surface_motion_mm: over the whole epicardial surface.
        largest_lv_motion_mm: over the left ventricle's epicardium below the mitral plane.
        wall_det_error: largest |det ∇χ − 1| in the left ventricle's wall, from 2 mm above the apex on.
        det_min, det_max: of ∇χ over the heart box, by central differences on a regular grid.
        inverse_error_mm: largest ‖χ(χ⁻¹(x)) − x‖ over heart, neighbours and phases, mismatch included.
    """

    lv_ejection_fraction: float
    rv_ejection_fraction: float
    la_expansion: float
    wall_thickening: float
    long_axis_shortening: float
    largest_surface_motion_mm: float
    largest_lv_motion_mm: float
    wall_det_error: float
    det_min: float
    det_max: float
    inverse_error_mm: float


def motion_report(anatomy: PhantomAnatomy, *, points: int = 40_000) -> MotionReport:
    """Measure the motion of `anatomy`; `points` are drawn for the errors, from a fixed seed."""
    es = anatomy.es_fraction
    axes = [np.arange(low, high, VOLUME_STEP_MM) for low, high in anatomy.box_mm.T]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    det = jacobian_determinant(anatomy, nodes, es)
    codes = tissue_at(anatomy.shapes, nodes, ultrasound=False)
    still, contracted = _lv_wall(anatomy, 0.0), _lv_wall(anatomy, es)
    rng = np.random.default_rng(0)
    wall = lv_wall_points(anatomy, rng, points // 4)
    moved = anatomy.deformed(anatomy.ed_vertices_mm, es) - anatomy.ed_vertices_mm
    return MotionReport(
        lv_ejection_fraction=1.0 - _volume_ratio(det, codes, Tissue.LV_BLOOD),
        rv_ejection_fraction=1.0 - _volume_ratio(det, codes, Tissue.RV_BLOOD),
        la_expansion=_volume_ratio(det, codes, *LEFT_ATRIUM) - 1.0,
        wall_thickening=contracted[0] / still[0] - 1.0,
        long_axis_shortening=1.0 - contracted[1] / still[1],
        largest_surface_motion_mm=float(np.linalg.norm(moved, axis=1).max()),
        largest_lv_motion_mm=_largest_lv_motion(anatomy, es),
        wall_det_error=float(np.abs(jacobian_determinant(anatomy, wall, es) - 1.0).max()),
        det_min=float(det.min()),
        det_max=float(det.max()),
        inverse_error_mm=inverse_error(anatomy, rng, points),
    )


def jacobian_determinant(anatomy: PhantomAnatomy, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
    """Compute (n,) det ∇χ at (n, 3) reference points by five-point differences, to below 1e-9."""
    columns = []
    for axis in DET_STEP_MM * np.eye(3):
        near, far = (
            anatomy.deformed(xyz_mm + k * axis, model_phase)
            - anatomy.deformed(xyz_mm - k * axis, model_phase)
            for k in (1, 2)
        )
        columns.append((8.0 * near - far) / (12.0 * DET_STEP_MM))
    return np.asarray(np.linalg.det(np.stack(columns, axis=-1)))


def lv_wall_points(anatomy: PhantomAnatomy, rng: np.random.Generator, count: int) -> FloatArray:
    """Draw (count, 3) points of the left ventricle's wall at end-diastole, frame "mr".

    They stay away from its two surfaces and from the lowest 2 mm of the pointed apex.
    """
    z, angle = rng.uniform(2.0, lv.BASE - 0.01, count), rng.uniform(0.0, 2 * np.pi, count)
    cavity = anatomy.shapes.heart.lv_cavity
    outer, inner = np.array([lv.radii(height, cavity) for height in z]).T
    return _from_cylinder(anatomy, z, inner + (outer - inner) * rng.uniform(0.02, 0.98, count), angle)


def inverse_error(anatomy: PhantomAnatomy, rng: np.random.Generator, count: int) -> float:
    """Measure the largest ‖χ(χ⁻¹(x)) − x‖ in mm at random points and phases of the neighbourhood."""
    box = anatomy.box_mm + np.array([[-20.0], [20.0]])
    worst = 0.0
    for phase in (0.0, 0.1, 0.25, anatomy.es_fraction, 0.6, 0.9):
        here = rng.uniform(box[0], box[1], (count // 6, 3))
        again = anatomy.mismatch.forward(anatomy.deformed(anatomy.material(here, phase), phase))
        worst = max(worst, float(np.linalg.norm(again - here, axis=1).max()))
    return worst


def _volume_ratio(det: FloatArray, codes: NDArray[np.uint8], *tissues: Tissue) -> float:
    return float(det[np.isin(codes, tissues)].mean())


def _lv_wall(anatomy: PhantomAnatomy, model_phase: float) -> tuple[float, float]:
    """Measure the wall's mean thickness half-way up, and the mitral plane's height above the apex."""
    angle = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    height = np.full(24, lv.BASE / 2)
    outer, inner = (
        anatomy.deformed(_from_cylinder(anatomy, height, np.full(24, r), angle), model_phase)
        for r in lv.radii(lv.BASE / 2, anatomy.shapes.heart.lv_cavity)
    )
    ends = _from_cylinder(anatomy, np.array([0.0, lv.BASE]), np.array([0.0, 29.0]), np.zeros(2))
    apex, base = _in_heart(anatomy, ends, model_phase)
    return float(np.linalg.norm(outer - inner, axis=1).mean()), float(base[2] - apex[2])


def _largest_lv_motion(anatomy: PhantomAnatomy, model_phase: float) -> float:
    z, angle = np.meshgrid(np.linspace(0.0, lv.BASE, 60), np.linspace(0.0, 2 * np.pi, 24))
    outer = np.array([lv.outer_radius(height) for height in z.ravel()])
    points = _from_cylinder(anatomy, z.ravel(), outer, angle.ravel())
    return float(np.linalg.norm(anatomy.deformed(points, model_phase) - points, axis=1).max())


def _from_cylinder(
    anatomy: PhantomAnatomy, z_mm: FloatArray, radius_mm: FloatArray, angle_rad: FloatArray
) -> FloatArray:
    local = np.column_stack([radius_mm * np.cos(angle_rad), radius_mm * np.sin(angle_rad), z_mm])
    return anatomy.placed(local)


def _in_heart(anatomy: PhantomAnatomy, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
    return anatomy.shapes.mr_from_heart.inverse().apply_array(anatomy.deformed(xyz_mm, model_phase))
