"""How many phases a dynamic fixture needs: blends between phases against the phantom's exact motion."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.heart.motion import MotionPreset
from dvf_ig.core import CycleTiming, DvfModel, FloatArray, Grid, InvalidInputError, Mesh, read_only_arrays
from dvf_ig.guidance import Evaluator, Sigmoid
from dvf_ig.guidance.blend import BLEND_CODES
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


@dataclass(frozen=True, slots=True)
class BlendError:
    """One motion, blend and number of phases.

    Attributes:
        motion, blend, phases: what is judged.
        surface_mean_mm, surface_p95_mm, surface_max_mm: at points of the true surface: how far off the
            fixture feels it, |ln(f/(1 − f))|/γ with f = |F|/cap (0 where the force is half of the cap);
            at random instants of the cycle.
        force_mean_n, force_p95_n, force_max_n: |F − true F| at points within 3 mm of the true surface, at the
            same instants.
        blend_mean_mm, blend_p95_mm: the blend's own share: what the fixture feels against the spline fitted
            to that very instant, at the phases of the other models that lie between those of this one; None
            where there are none.
    """

    motion: str
    blend: str
    phases: int
    surface_mean_mm: float
    surface_p95_mm: float
    surface_max_mm: float
    force_mean_n: float
    force_p95_n: float
    force_max_n: float
    blend_mean_mm: float | None
    blend_p95_mm: float | None


@dataclass(frozen=True, slots=True)
class BlendStudy:
    """All errors of one motion, the errors that are left at the phases themselves (the fit's, not the
    blend's), and how far the surface moves at most from end-diastole."""

    motion: str
    errors: tuple[BlendError, ...]
    at_phases: BlendError
    largest_motion_mm: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Truth:
    """What the fixture should answer: (k,) phases, (k, 3) points on the surface, others around it, forces."""

    phase: FloatArray
    on_surface_mm: FloatArray
    around_mm: FloatArray
    force_n: FloatArray


def blending_errors(
    motion: MotionPreset,
    counts: Sequence[int],
    *,
    knot_spacing_mm: float = 3.6,
    threads: int = 1,
    seed: int,
    report: Callable[[float], None] = lambda _: None,
) -> BlendStudy:
    """Errors of every blend for models of `counts` evenly spaced phases.

    The same spline stands for the same phase in every model, so that only the blend differs.

    Args:
        motion: preset of the phantom.
        counts: numbers of phases, each at least 4.
        knot_spacing_mm: of the models.
        threads: phases fitted at a time; has no influence on the result.
        seed: of the heart, the instants and the points.
        report: told the share of the phases that is fitted.
    Raises:
        InvalidInputError: no counts, or fewer than 4 phases.
    """
    if not counts or min(counts) < 4:
        raise InvalidInputError(f"numbers of phases are {list(counts)}; needed at least one, each 4 or more")
    anatomy = phantom_anatomy(motion=motion, mismatch_mm=0.0, seed=seed)
    rng = np.random.default_rng([seed, 0xB1E4D])
    law = Sigmoid()
    between = _truth(anatomy, (np.arange(INSTANTS) + rng.uniform(size=INSTANTS)) / INSTANTS, law, rng)
    fitted, grid = _fitted(anatomy, counts, knot_spacing_mm, threads, report)
    models = {count: _model(anatomy, fitted, grid, count, knot_spacing_mm) for count in sorted(set(counts))}
    static = [_static(anatomy, phase, fitted[phase], grid, knot_spacing_mm, rng) for phase in fitted]
    errors = [
        _error(motion, blend, model, law, between, static)
        for blend in BLEND_CODES
        for model in models.values()
    ]
    densest = models[max(models)]
    stored = _truth(anatomy, densest.timing.fractions, law, rng)
    return BlendStudy(
        motion,
        tuple(errors),
        _error(motion, "distance", densest, law, stored, []),
        float(max(_moved_mm(anatomy, phase) for phase in np.arange(50) / 50)),
    )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Static:
    """A phase with a spline of its own: (k, 3) points on the true surface, and how deep each lies in it."""

    phase: Fraction
    points_mm: FloatArray
    depth_mm: FloatArray


def _static(
    anatomy: PhantomAnatomy,
    phase: Fraction,
    coefficients: NDArray[np.float32],
    grid: Grid,
    knot_spacing_mm: float,
    rng: np.random.Generator,
) -> _Static:
    points, _ = random_surface_points(_mesh(anatomy, float(phase)), STATIC_POINTS, rng)
    distance, gradient = SplineField(coefficients[None], grid.origin_mm, knot_spacing_mm).at(points)
    return _Static(phase, points, distance / np.linalg.norm(gradient, axis=1))


def _moved_mm(anatomy: PhantomAnatomy, phase: float) -> float:
    moved = anatomy.deformed(anatomy.ed_vertices_mm, phase) - anatomy.ed_vertices_mm
    return float(np.linalg.norm(moved, axis=1).max())


def _mesh(anatomy: PhantomAnatomy, phase: float) -> Mesh:
    return Mesh("mr", anatomy.deformed(anatomy.ed_vertices_mm, phase), anatomy.triangles)


def _truth(anatomy: PhantomAnatomy, phases: FloatArray, law: Sigmoid, rng: np.random.Generator) -> _Truth:
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
        force.append(law.cap_n * law.potential(depth_mm)[:, None] * outward)
    each = np.repeat(phases, POINTS_PER_INSTANT)
    return _Truth(each, np.concatenate(surface), np.concatenate(around), np.concatenate(force))


def _fitted(
    anatomy: PhantomAnatomy,
    counts: Sequence[int],
    knot_spacing_mm: float,
    threads: int,
    report: Callable[[float], None],
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
            report(len(fitted) / len(phases))
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
        patient_id=f"phantom-{anatomy.seed}",
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


def _error(
    motion: str, blend: str, model: DvfModel, law: Sigmoid, truth: _Truth, static: Sequence[_Static]
) -> BlendError:
    chosen = next(name for name in BLEND_CODES if name == blend)
    fixture = Evaluator(model, law, blend=chosen)
    off_mm = np.abs(_felt_depth_mm(fixture, law, truth.on_surface_mm, truth.phase))
    force_n = fixture.force(truth.around_mm, truth.phase).force_n
    wrong_n = np.linalg.norm(force_n - truth.force_n, axis=1)
    own_mm = [
        np.abs(_felt_depth_mm(fixture, law, one.points_mm, np.array(float(one.phase))) - one.depth_mm)
        for one in static
        if (one.phase * model.phases).denominator > 1
    ]
    own = _three(np.concatenate(own_mm))[:2] if own_mm else (None, None)
    return BlendError(motion, blend, model.phases, *_three(off_mm), *_three(wrong_n), *own)


def _felt_depth_mm(fixture: Evaluator, law: Sigmoid, xyz_mm: FloatArray, phase: FloatArray) -> FloatArray:
    """(n,) depth at which the law alone would give the force that is felt."""
    felt = np.linalg.norm(fixture.force(xyz_mm, phase).force_n, axis=1) / law.cap_n
    return np.asarray(np.log(felt / (1.0 - felt)) / law.gamma_per_mm)


def _three(values: FloatArray) -> tuple[float, float, float]:
    return float(values.mean()), float(np.percentile(values, 95)), float(values.max())
