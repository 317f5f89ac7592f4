"""How many phases a dynamic fixture needs: blends between phases against the phantom's exact motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from data_synth.heart.motion import MotionPreset
from dvf_ig.core import DvfModel, FloatArray, InvalidInputError, part_of, read_only_arrays
from dvf_ig.guidance import Evaluator
from dvf_ig.guidance.blend import BLEND_CODES

from .hearts import LAW, ExactAnswer, FittedPhase, beating_heart


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
    """All errors of one motion, pooled over the hearts.

    Attributes:
        motion: preset.
        errors: of every blend and number of phases.
        at_phases: what is left at the phases themselves: the error of the fit, not of the blend.
        largest_motion_mm: how far the surface moves at most from end-diastole.
    """

    motion: str
    errors: tuple[BlendError, ...]
    at_phases: BlendError
    largest_motion_mm: float


def blending_errors(
    motion: MotionPreset,
    counts: Sequence[int],
    *,
    knot_spacing_mm: float = 3.6,
    threads: int = 1,
    seeds: Sequence[int],
    progress: Callable[[float], None] = lambda _: None,
) -> BlendStudy:
    """Errors of every blend for models of `counts` evenly spaced phases.

    The same spline stands for the same phase in every model, so that only the blend differs.

    Args:
        motion: preset of the phantom.
        counts: numbers of phases, each at least 4.
        knot_spacing_mm: of the models.
        threads: phases fitted at a time; has no influence on the result.
        seeds: one for each heart, with its instants and points.
        progress: told the share of the phases that is fitted.
    Raises:
        InvalidInputError: no counts, fewer than 4 phases, or no heart.
    """
    if not counts or min(counts) < 4:
        raise InvalidInputError(f"numbers of phases are {list(counts)}; needed at least one, each 4 or more")
    if not seeds:
        raise InvalidInputError("no heart was asked for; needed at least one seed")
    hearts = [
        beating_heart(motion, counts, knot_spacing_mm, threads, seed, part_of(progress, k, len(seeds)))
        for k, seed in enumerate(seeds)
    ]
    densest = max(counts)
    errors = [
        _pooled(motion, blend, count, [_errors(h.models[count], blend, h.between, h.fitted) for h in hearts])
        for blend in BLEND_CODES
        for count in hearts[0].models
    ]
    left = [_errors(heart.models[densest], "distance", heart.stored, ()) for heart in hearts]
    return BlendStudy(
        motion,
        tuple(errors),
        _pooled(motion, "distance", densest, left),
        max(heart.largest_motion_mm for heart in hearts),
    )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Errors:
    """Errors of one model at its points: see `BlendError`."""

    surface_mm: FloatArray
    force_n: FloatArray
    blend_mm: FloatArray


def _errors(model: DvfModel, blend: str, truth: ExactAnswer, fitted: Sequence[FittedPhase]) -> _Errors:
    chosen = next(name for name in BLEND_CODES if name == blend)
    fixture = Evaluator(model, LAW, blend=chosen)
    surface_mm = np.abs(_rendered_depth_mm(fixture, truth.on_surface_mm, truth.phase))
    force_n = fixture.force(truth.around_mm, truth.phase).force_n
    blend_mm = [
        np.abs(_rendered_depth_mm(fixture, other.points_mm, np.array(float(other.phase))) - other.depth_mm)
        for other in fitted
        if (other.phase * model.phases).denominator > 1
    ]
    return _Errors(
        surface_mm, np.linalg.norm(force_n - truth.force_n, axis=1), np.concatenate([np.empty(0), *blend_mm])
    )


def _pooled(motion: str, blend: str, count: int, hearts: Sequence[_Errors]) -> BlendError:
    surface_mm = np.concatenate([errors.surface_mm for errors in hearts])
    force_n = np.concatenate([errors.force_n for errors in hearts])
    blend_mm = np.concatenate([errors.blend_mm for errors in hearts])
    own = _mean_p95_max(blend_mm)[:2] if len(blend_mm) else (None, None)
    return BlendError(motion, blend, count, *_mean_p95_max(surface_mm), *_mean_p95_max(force_n), *own)


def _rendered_depth_mm(fixture: Evaluator, xyz_mm: FloatArray, phase: FloatArray) -> FloatArray:
    """(n,) depth at which the law alone would give the force that is rendered."""
    share = np.linalg.norm(fixture.force(xyz_mm, phase).force_n, axis=1) / LAW.cap_n
    return np.asarray(np.log(share / (1.0 - share)) / LAW.gamma_per_mm)


def _mean_p95_max(values: FloatArray) -> tuple[float, float, float]:
    return float(values.mean()), float(np.percentile(values, 95)), float(values.max())
