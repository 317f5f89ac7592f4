"""How far the fitted model lies from the surface it was fitted to."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, DvfModel, FloatArray, IntArray, InvalidInputError, Mesh
from dvf_ig.kernels import status as code
from dvf_ig.kernels.spline import spline_batch

from .closing import triangle_areas_mm2
from .triangle_tree import build_triangle_tree

CAP_RIM_MM = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class ModelCheck:
    """Distance between fitted and reference surface at area-uniform random points.

    Attributes:
        mean_mm, p99_mm, max_mm: over all points of all phases.
        per_phase_mm: (n,) mean of each phase.
        points: how many points were judged.
        excluded_area_share: share of the area left out: caps, and what lies within rim_mm of a cap.
        rim_mm: width of that rim.
    """

    mean_mm: float
    p99_mm: float
    max_mm: float
    per_phase_mm: FloatArray
    points: int
    excluded_area_share: float
    rim_mm: float


def check_model(model: DvfModel, *, points_per_phase: int = 4000, rng: np.random.Generator) -> ModelCheck:
    """Surface error |d|/|∇d| of the spline at random points of the reference triangles, never its vertices.

    Args:
        model: the model, with the surfaces it was fitted to.
        points_per_phase: random points drawn on each phase, before caps and their rim are left out.
        rng: source of the points.
    Raises:
        InvalidInputError: a phase where caps leave nothing to judge.
    """
    errors = []
    kept = 0
    for i, (mesh, caps) in enumerate(zip(model.reference, model.reference_caps, strict=True)):
        points = _measured_points(mesh, caps, points_per_phase, rng)
        if len(points) == 0:
            raise InvalidInputError(f"phase {i}: all of the surface lies within {CAP_RIM_MM} mm of a cap")
        kept += len(points)
        errors.append(_surface_error_mm(model, i, points))
    together = np.concatenate(errors)
    return ModelCheck(
        float(together.mean()),
        float(np.percentile(together, 99)),
        float(together.max()),
        np.array([e.mean() for e in errors]),
        len(together),
        1.0 - kept / (points_per_phase * model.phases),
        CAP_RIM_MM,
    )


def random_surface_points(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """(n, 3) area-uniform points on a mesh and (n,) the triangle of each."""
    area = triangle_areas_mm2(mesh.vertices_mm, mesh.triangles)
    triangle = rng.choice(len(area), size=count, p=area / area.sum())
    root = np.sqrt(rng.uniform(size=count))
    along = rng.uniform(size=count)
    weights = np.stack([1.0 - root, root * (1.0 - along), root * along], axis=1)
    return np.einsum("nk,nkx->nx", weights, mesh.vertices_mm[mesh.triangles[triangle]]), triangle


def _measured_points(mesh: Mesh, caps: BoolArray, count: int, rng: np.random.Generator) -> FloatArray:
    points, triangle = random_surface_points(mesh, count, rng)
    if not caps.any():
        return points
    from_cap_mm = build_triangle_tree(mesh.vertices_mm, mesh.triangles[caps]).distance_mm(points)
    judged: FloatArray = points[~caps[triangle] & (from_cap_mm > CAP_RIM_MM)]
    return judged


def _surface_error_mm(model: DvfModel, phase: int, points: FloatArray) -> FloatArray:
    n = len(points)
    distance, gradient, status = np.empty(n), np.empty((n, 3)), np.empty(n, dtype=np.int64)
    spline_batch(
        model.coefficients,
        model.origin_mm,
        model.knot_spacing_mm,
        phase,
        np.ascontiguousarray(points),
        distance,
        gradient,
        status,
    )
    if (status != code.OK).any():
        raise InvalidInputError(
            f"phase {phase}: the reference surface leaves the model's box; build it again"
        )
    norm = np.linalg.norm(gradient, axis=1)
    return np.asarray(np.abs(distance) / np.maximum(norm, 1e-9))
