"""Surface and normal error of a fitted model against the surfaces to which it was fitted; their normals."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, DvfModel, FloatArray, IntArray, InvalidInputError, Mesh, read_only_arrays
from dvf_ig.preop.distance.triangle_tree import Nearest, build_triangle_tree
from dvf_ig.preop.spline.field import SplineField
from dvf_ig.preop.surface.closing import triangle_areas_mm2

CAP_RIM_MM = 5.0
"""Width of the rim around caps that is left out."""
NORMAL_BAND_MM = 2.0
NORMAL_POINTS_SHARE = 0.25
"""Share of points at which normals are evaluated: each needs a search for the nearest surface point."""

MIN_OFFSET_MM = 0.05
"""Distance below which the gradient of the exact distance is taken from the facet."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PhaseErrors:
    """Errors of one phase of a model at random points.

    Attributes:
        surface_mm: (n,) distance |d|/|∇d| of the spline's zero level from area-uniform points of the
            triangles.
        normal_deg: (k,) angle between the spline's ∇d and the normal of the smooth surface (vertex normals,
            interpolated at the nearest surface point), at points within 2 mm of the surface.
        facet_normal_deg: (k,) angle between ∇d and the gradient of the exact distance to the triangles, at
            the same points; the normal of flat facets jumps by some degrees at each edge.
    """

    surface_mm: FloatArray
    normal_deg: FloatArray
    facet_normal_deg: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ModelCheck:
    """Errors of a model against its reference surfaces; PhaseErrors defines each of them.

    Attributes:
        mean_mm, p99_mm, max_mm: surface error over all points of all phases.
        per_phase_mm: (n,) mean of each phase.
        per_phase_p99_mm: (n,) 99th percentile of each phase.
        normal_median_deg, normal_p95_deg: of the angle to the smooth surface's normal, all phases.
        per_phase_normal_p95_deg: (n,) of each phase.
        facet_normal_median_deg, facet_normal_p95_deg: of the angle to the exact distance's gradient.
        points: number of surface points evaluated.
        excluded_area_share: share of the area left out: caps, and points within rim_mm of a cap.
        rim_mm: width of that rim.
    """

    mean_mm: float
    p99_mm: float
    max_mm: float
    per_phase_mm: FloatArray
    per_phase_p99_mm: FloatArray
    normal_median_deg: float
    normal_p95_deg: float
    per_phase_normal_p95_deg: FloatArray
    facet_normal_median_deg: float
    facet_normal_p95_deg: float
    points: int
    excluded_area_share: float
    rim_mm: float


def check_model(model: DvfModel, *, points_per_phase: int = 4000, rng: np.random.Generator) -> ModelCheck:
    """Measure surface and normal errors around random points of the reference triangles, never vertices.

    Args:
        model: the model, with the surfaces it was fitted to.
        points_per_phase: random points drawn on each phase, before caps and their rim are left out.
        rng: source of the points.
    Raises:
        InvalidInputError: a phase that is all caps and their rim.
    """
    errors = [phase_errors(model, i, points_per_phase, rng) for i in range(model.phases)]
    surface = np.concatenate([e.surface_mm for e in errors])
    normal = np.concatenate([e.normal_deg for e in errors])
    facet = np.concatenate([e.facet_normal_deg for e in errors])
    return ModelCheck(
        mean_mm=float(surface.mean()),
        p99_mm=float(np.percentile(surface, 99)),
        max_mm=float(surface.max()),
        per_phase_mm=np.array([e.surface_mm.mean() for e in errors]),
        per_phase_p99_mm=np.array([np.percentile(e.surface_mm, 99) for e in errors]),
        normal_median_deg=float(np.median(normal)),
        normal_p95_deg=float(np.percentile(normal, 95)),
        per_phase_normal_p95_deg=np.array([np.percentile(e.normal_deg, 95) for e in errors]),
        facet_normal_median_deg=float(np.median(facet)),
        facet_normal_p95_deg=float(np.percentile(facet, 95)),
        points=len(surface),
        excluded_area_share=1.0 - len(surface) / (points_per_phase * model.phases),
        rim_mm=CAP_RIM_MM,
    )


def phase_errors(model: DvfModel, phase: int, points: int, rng: np.random.Generator) -> PhaseErrors:
    """Measure the errors of one phase of a model; see `field_errors`."""
    field = SplineField.of_model(model, phase)
    return field_errors(field, model.reference[phase], model.reference_caps[phase], points, rng)


def field_errors(
    field: SplineField, mesh: Mesh, caps: BoolArray, points: int, rng: np.random.Generator
) -> PhaseErrors:
    """Measure a spline against a surface at up to `points` random points without caps and their rim.

    Raises:
        InvalidInputError: the surface is all caps and their rim, or leaves the spline's box.
    """
    on_surface, triangle = _measured_points(mesh, caps, points, rng)
    if len(on_surface) == 0:
        raise InvalidInputError(
            f"phase {field.phase}: all of the surface lies within {CAP_RIM_MM} mm of a cap"
        )
    chosen = slice(0, max(1, round(NORMAL_POINTS_SHARE * len(on_surface))))
    offset_mm = rng.uniform(-NORMAL_BAND_MM, NORMAL_BAND_MM, size=len(on_surface[chosen]))
    near = on_surface[chosen] + offset_mm[:, None] * facet_normals(mesh)[triangle[chosen]]
    return PhaseErrors(field.off_surface_mm(on_surface), *_normal_errors(field, mesh, near))


def random_surface_points(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """Draw (n, 3) area-uniform points on a mesh, with (n,) the triangle of each.

    Raises:
        InvalidInputError: a mesh without area.
    """
    area = triangle_areas_mm2(mesh.vertices_mm, mesh.triangles)
    if not area.sum() > 0.0:
        raise InvalidInputError("a surface has no area: its triangles are lines or points; build it again")
    triangle = rng.choice(len(area), size=count, p=area / area.sum())
    root = np.sqrt(rng.uniform(size=count))
    along = rng.uniform(size=count)
    weights = np.stack([1.0 - root, root * (1.0 - along), root * along], axis=1)
    return np.einsum("nk,nkx->nx", weights, mesh.vertices_mm[mesh.triangles[triangle]]), triangle


def _measured_points(
    mesh: Mesh, caps: BoolArray, count: int, rng: np.random.Generator
) -> tuple[FloatArray, IntArray]:
    points, triangle = random_surface_points(mesh, count, rng)
    measured = ~caps[triangle] & away_from_caps(mesh, caps, points)
    return points[measured], triangle[measured]


def away_from_caps(mesh: Mesh, caps: BoolArray, xyz_mm: FloatArray) -> BoolArray:
    """Flag (n,) points farther than the rim from every cap, which meets the surface in a false crease."""
    if not caps.any():
        return np.ones(len(xyz_mm), dtype=np.bool_)
    from_cap_mm = build_triangle_tree(mesh.vertices_mm, mesh.triangles[caps]).distance_mm(xyz_mm)
    return np.asarray(from_cap_mm > CAP_RIM_MM)


def _normal_errors(field: SplineField, mesh: Mesh, xyz_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute angles of ∇d to the smooth surface's inward normal, and to the exact distance's gradient."""
    nearest = build_triangle_tree(mesh.vertices_mm, mesh.triangles).nearest(xyz_mm)
    inward = -smooth_normals(mesh, vertex_normals(mesh), nearest)
    to_surface = nearest.points_mm - xyz_mm
    exact = np.where(np.einsum("nx,nx->n", to_surface, inward)[:, None] < 0.0, -to_surface, to_surface)
    on_facet = nearest.distance_mm < MIN_OFFSET_MM
    exact[on_facet] = -facet_normals(mesh)[nearest.triangle[on_facet]]
    _, gradient = field.at(xyz_mm)
    return angle_deg(gradient, inward), angle_deg(gradient, exact)


def facet_normals(mesh: Mesh) -> FloatArray:
    """Compute (t, 3) outward unit normals; zero for a triangle without area."""
    a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
    return _unit(np.cross(b - a, c - a))


def vertex_normals(mesh: Mesh) -> FloatArray:
    """Compute (v, 3) outward unit normals: facets averaged by their angle (Thürmer and Wüthrich 1998)."""
    facets = facet_normals(mesh)
    corners = mesh.vertices_mm[mesh.triangles]
    out = np.zeros_like(mesh.vertices_mm)
    for k in range(3):
        one = _unit(corners[:, (k + 1) % 3] - corners[:, k])
        other = _unit(corners[:, (k + 2) % 3] - corners[:, k])
        angle = np.arccos(np.clip(np.einsum("tx,tx->t", one, other), -1.0, 1.0))
        for x in range(3):
            weights = angle * facets[:, x]
            out[:, x] += np.bincount(mesh.triangles[:, k], weights=weights, minlength=len(out))
    return _unit(out)


def smooth_normals(mesh: Mesh, of_vertices: FloatArray, nearest: Nearest) -> FloatArray:
    """Interpolate (n, 3) unit normals at surface points from those of the triangle's corners.

    Args:
        mesh: the surface; of_vertices: its `vertex_normals`.
        nearest: points of the surface.
    """
    return _unit(np.einsum("nk,nkx->nx", nearest.weights, of_vertices[mesh.triangles[nearest.triangle]]))


def angle_deg(one: FloatArray, other: FloatArray) -> FloatArray:
    """Compute (n,) angles between vectors; accurate for small angles, 0 if either vector is zero."""
    across = np.linalg.norm(np.cross(one, other), axis=1)
    return np.asarray(np.degrees(np.arctan2(across, np.einsum("nx,nx->n", one, other))))


def _unit(vectors: FloatArray) -> FloatArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))
