"""Choice of the knot pitch: the coarsest that reaches a required accuracy on the most contracted phase."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, Grid, InvalidInputError, Mesh
from dvf_ig.preop.spline.field import SplineField
from dvf_ig.preop.spline.fit import axis_solvers, fit_phase, sample_grid
from dvf_ig.preop.surface.closing import triangle_areas_mm2

from .check import CAP_RIM_MM, away_from_caps

log = logging.getLogger(__name__)

PITCHES_MM = (6.0, 5.0, 4.5, 4.0, 3.6, 3.2, 2.9, 2.6, 2.3, 2.0, 1.8, 1.6)
"""Pitches tried, coarsest first, in steps of about a tenth."""

P99_SHARE = 4.0
"""Largest 99th percentile over the required mean."""


@dataclass(frozen=True, slots=True)
class KnotTrial:
    """One pitch tried on that phase: area-weighted surface error, without caps and their rim."""

    knot_spacing_mm: float
    mean_mm: float
    p99_mm: float


@dataclass(frozen=True, slots=True)
class KnotChoice:
    """The chosen pitch, the phase on which it was chosen, and every pitch tried, coarsest first."""

    knot_spacing_mm: float
    phase: int
    tried: tuple[KnotTrial, ...]


def choose_knot_spacing(
    reference: Sequence[Mesh],
    caps: Sequence[BoolArray],
    accuracy_mm: float,
    *,
    margin_mm: float,
    band_mm: float,
) -> KnotChoice:
    """Choose the coarsest pitch with mean <= accuracy and p99 <= 4 × accuracy on the most contracted phase.

    The phase that encloses the smallest volume is the most curved.

    Args:
        reference: closed surfaces, one a phase; caps: their unmeasured triangles.
        accuracy_mm: required mean surface error.
        margin_mm, band_mm: margin and band of the model.
    Raises:
        InvalidInputError: the finest pitch does not reach the accuracy.
    """
    phase = int(np.argmin([mesh.volume_mm3() for mesh in reference]))
    tried: list[KnotTrial] = []
    for pitch_mm in PITCHES_MM:
        grid = sample_grid(reference, reference[phase].frame, pitch_mm, margin_mm)
        tried.append(_trial(reference[phase], caps[phase], grid, pitch_mm, band_mm))
        log.info("knots every %g mm: mean %.4f, p99 %.4f mm", pitch_mm, tried[-1].mean_mm, tried[-1].p99_mm)
        if tried[-1].mean_mm <= accuracy_mm and tried[-1].p99_mm <= P99_SHARE * accuracy_mm:
            return KnotChoice(pitch_mm, phase, tuple(tried))
    last = tried[-1]
    raise InvalidInputError(
        f"an accuracy of {accuracy_mm:g} mm is out of reach: knots every {last.knot_spacing_mm:g} mm leave "
        f"{last.mean_mm:.3f} mm mean and {last.p99_mm:.3f} mm p99 on phase {phase}; allow a larger error, "
        "smooth the surface, or give --knot-mm"
    )


def _trial(mesh: Mesh, caps: BoolArray, grid: Grid, pitch_mm: float, band_mm: float) -> KnotTrial:
    fitted = fit_phase(mesh, grid, axis_solvers(grid), band_mm)
    points, area = _quadrature(mesh, caps)
    error = SplineField(fitted[None], grid.origin_mm, pitch_mm).off_surface_mm(points)
    order = np.argsort(error)
    below = np.cumsum(area[order]) / area.sum()
    p99 = error[order][min(int(np.searchsorted(below, 0.99)), len(error) - 1)]
    return KnotTrial(pitch_mm, float(np.average(error, weights=area)), float(p99))


def _quadrature(mesh: Mesh, caps: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Compute (n, 3) centroids of the quarters of every measured triangle, and the area of each quarter."""
    measured = mesh.triangles[~caps]
    inner = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]], dtype=np.float64)
    weights = inner / inner.sum(axis=1, keepdims=True)
    points = np.einsum("qk,tkx->qtx", weights, mesh.vertices_mm[measured]).reshape(-1, 3)
    area = np.repeat(0.25 * triangle_areas_mm2(mesh.vertices_mm, measured), len(inner))
    measured_points = away_from_caps(mesh, caps, points)
    if not measured_points.any():
        raise InvalidInputError(f"all of the surface lies within {CAP_RIM_MM} mm of a cap; give --knot-mm")
    return np.ascontiguousarray(points[measured_points]), area[measured_points]
