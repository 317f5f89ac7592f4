"""Spline fit of one phase (Ren 2008, eqs 1 and 2): sample grid, signed distances, weighted least squares."""

from collections.abc import Sequence

import numpy as np

from dvf_ig.core import FloatArray, Grid, Mesh
from dvf_ig.preop.distance.signed import signed_distance_mm

from .fit import SAMPLES_PER_KNOT, AxisSolver, AxisSolvers, fit_weighted, surface_weights


def sample_grid(reference: Sequence[Mesh], frame: str, knot_spacing_mm: float, margin_mm: float) -> Grid:
    """Lay samples at half the knot pitch over everything the surfaces sweep, plus the margin."""
    lower = np.min([mesh.vertices_mm.min(axis=0) for mesh in reference], axis=0) - margin_mm
    upper = np.max([mesh.vertices_mm.max(axis=0) for mesh in reference], axis=0) + margin_mm
    cells = 2 * np.ceil((upper - lower) / (2.0 * knot_spacing_mm)).astype(int)
    origin = 0.5 * (lower + upper) - 0.5 * cells * knot_spacing_mm
    shape = tuple(int(n) * SAMPLES_PER_KNOT + 1 for n in cells)
    return Grid.axis_aligned(
        frame, (shape[0], shape[1], shape[2]), origin, knot_spacing_mm / SAMPLES_PER_KNOT
    )


def axis_solvers(grid: Grid) -> AxisSolvers:
    """Prepare least squares along each axis of a sample grid."""
    x, y, z = (AxisSolver.of((n - 1) // SAMPLES_PER_KNOT) for n in grid.shape)
    return x, y, z


def fit_phase(mesh: Mesh, grid: Grid, solvers: AxisSolvers, band_mm: float) -> FloatArray:
    """Fit (cx, cy, cz) spline coefficients in mm to the signed distance, best at the surface."""
    samples = signed_distance_mm(mesh, grid, band_mm)
    knot_spacing_mm = SAMPLES_PER_KNOT * float(grid.spacing_mm[0])
    return fit_weighted(samples, surface_weights(samples, knot_spacing_mm), solvers)
