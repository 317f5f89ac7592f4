"""Hearts of the blending study: a model of each number of phases, and the exact answer it is held to."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.heart.motion import MotionPreset
from dvf_ig.core import CycleTiming, DvfModel, FloatArray, Grid, Mesh, read_only_arrays
from dvf_ig.guidance import Sigmoid
from dvf_ig.preop import (
    SplineField,
    build_triangle_tree,
    facet_normals,
    random_surface_points,
    smooth_normals,
    vertex_normals,
)
from dvf_ig.preop.spline.phase_fit import axis_solvers, fit_phase, sample_grid

INSTANTS = 40
POINTS_PER_INSTANT = 400
STATIC_POINTS = 300
REACH_MM = 3.0
MARGIN_MM, BAND_MM = 15.0, 4.0
LAW = Sigmoid()


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ExactAnswer:
    """The exact answer: (k,) phases, (k, 3) points on the surface, (k, 3) points around it, forces there."""

    phase: FloatArray
    on_surface_mm: FloatArray
    around_mm: FloatArray
    force_n: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FittedPhase:
    """A phase with a spline of its own: (k, 3) points on the true surface, and how deep each lies in it."""

    phase: Fraction
    points_mm: FloatArray
    depth_mm: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class BeatingHeart:
    """A heart, its models, and what they are judged against.

    Attributes:
        models: by number of phases, ascending.
        between: the exact answer at random instants of the cycle.
        stored: the exact answer at the phases of the model that has most.
        fitted: every phase that any of the models has.
        largest_motion_mm: of the surface, from end-diastole.
    """

    models: dict[int, DvfModel]
    between: ExactAnswer
    stored: ExactAnswer
    fitted: tuple[FittedPhase, ...]
    largest_motion_mm: float


def beating_heart(
    motion: MotionPreset,
    counts: Sequence[int],
    knot_spacing_mm: float,
    threads: int,
    seed: int,
    progress: Callable[[float], None],
) -> BeatingHeart:
    """The phantom's heart of a seed; arguments as in `blending_errors`."""
    anatomy = phantom_anatomy(motion=motion, mismatch_mm=0.0, seed=seed)
    rng = np.random.default_rng([seed, 0xB1E4D])
    between = _exact_answer(anatomy, (np.arange(INSTANTS) + rng.uniform(size=INSTANTS)) / INSTANTS, rng)
    fitted, grid = _fitted(anatomy, counts, knot_spacing_mm, threads, progress)
    models = {count: _model(anatomy, fitted, grid, count, knot_spacing_mm) for count in sorted(set(counts))}
    phases = tuple(
        _fitted_phase(anatomy, phase, fitted[phase], grid, knot_spacing_mm, rng) for phase in fitted
    )
    stored = _exact_answer(anatomy, models[max(models)].timing.fractions, rng)
    largest_mm = max(_moved_mm(anatomy, phase) for phase in np.arange(50) / 50)
    return BeatingHeart(models, between, stored, phases, float(largest_mm))


def _fitted_phase(
    anatomy: PhantomAnatomy,
    phase: Fraction,
    coefficients: NDArray[np.float32],
    grid: Grid,
    knot_spacing_mm: float,
    rng: np.random.Generator,
) -> FittedPhase:
    points, _ = random_surface_points(_mesh(anatomy, float(phase)), STATIC_POINTS, rng)
    distance, gradient = SplineField(coefficients[None], grid.origin_mm, knot_spacing_mm).at(points)
    return FittedPhase(phase, points, distance / np.linalg.norm(gradient, axis=1))


def _moved_mm(anatomy: PhantomAnatomy, phase: float) -> float:
    moved = anatomy.deformed(anatomy.ed_vertices_mm, phase) - anatomy.ed_vertices_mm
    return float(np.linalg.norm(moved, axis=1).max())


def _mesh(anatomy: PhantomAnatomy, phase: float) -> Mesh:
    return Mesh("mr", anatomy.deformed(anatomy.ed_vertices_mm, phase), anatomy.triangles)


def _exact_answer(anatomy: PhantomAnatomy, phases: FloatArray, rng: np.random.Generator) -> ExactAnswer:
    """Points of the moved triangles, and around them forces from the exact distance and smooth normals."""
    surface, around, force = [], [], []
    for phase in phases:
        mesh = _mesh(anatomy, float(phase))
        points, triangle = random_surface_points(mesh, POINTS_PER_INSTANT, rng)
        offset_mm = rng.uniform(-REACH_MM, REACH_MM, size=(len(points), 1))
        near = points + offset_mm * facet_normals(mesh)[triangle]
        nearest = build_triangle_tree(mesh.vertices_mm, mesh.triangles).nearest(near)
        outward = smooth_normals(mesh, vertex_normals(mesh), nearest)
        inside = np.einsum("nx,nx->n", near - nearest.points_mm, outward) < 0.0
        depth_mm = np.where(inside, nearest.distance_mm, -nearest.distance_mm)
        surface.append(points)
        around.append(near)
        force.append(LAW.cap_n * LAW.potential(depth_mm)[:, None] * outward)
    each = np.repeat(phases, POINTS_PER_INSTANT)
    return ExactAnswer(each, np.concatenate(surface), np.concatenate(around), np.concatenate(force))


def _fitted(
    anatomy: PhantomAnatomy,
    counts: Sequence[int],
    knot_spacing_mm: float,
    threads: int,
    progress: Callable[[float], None],
) -> tuple[dict[Fraction, NDArray[np.float32]], Grid]:
    """Coefficients by phase, every phase that any of the models needs, on one grid."""
    phases = sorted({Fraction(i, count) for count in counts for i in range(count)})
    meshes = [_mesh(anatomy, float(phase)) for phase in phases]
    grid = sample_grid(meshes, "mr", knot_spacing_mm, MARGIN_MM)
    solvers = axis_solvers(grid)
    fitted: dict[Fraction, NDArray[np.float32]] = {}
    with ThreadPoolExecutor(threads) as pool:
        every = pool.map(lambda mesh: fit_phase(mesh, grid, solvers, BAND_MM).astype(np.float32), meshes)
        for phase, coefficients in zip(phases, every, strict=True):
            fitted[phase] = coefficients
            progress(len(fitted) / len(phases))
    return fitted, grid


def _model(
    anatomy: PhantomAnatomy,
    fitted: dict[Fraction, NDArray[np.float32]],
    grid: Grid,
    count: int,
    knot_spacing_mm: float,
) -> DvfModel:
    phases = [Fraction(i, count) for i in range(count)]
    meshes = tuple(_mesh(anatomy, float(phase)) for phase in phases)
    return DvfModel(
        patient_id=f"phantom-{anatomy.seeds.anatomy}",
        surface_name="EPICARDIAL",
        frame="mr",
        timing=CycleTiming.uniform(count, anatomy.rr_s),
        es_fraction=anatomy.es_fraction,
        ed_phase=0,
        coefficients=np.stack([fitted[phase] for phase in phases]),
        origin_mm=grid.origin_mm,
        knot_spacing_mm=knot_spacing_mm,
        reference=meshes,
        reference_caps=tuple(np.zeros(len(mesh.triangles), dtype=np.bool_) for mesh in meshes),
    )
