"""Draw the fitted surface, potential 0.5, against the original surface: Ren 2008, Fig. 4 (inferred).

The figure itself was not available; the paper's text compares these surfaces, 0.36 ± 0.22 mm apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dvf_ig.core import DvfModel, FloatArray, read_only_arrays
from dvf_ig.guidance import Sigmoid
from dvf_ig.preop import SplineField, phase_errors
from dvf_ig.report.plane_overlay import plane_section
from dvf_ig.report.style import ESTIMATE, TRUTH, open_frame

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAPER_MEAN_MM, PAPER_SD_MM = 0.36, 0.22
"""Distance of the 0.5-potential surface from the original one in Ren 2008."""
SHOWN_MM = 8.0
"""Side of the enlarged square."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SurfaceFit:
    """One phase of a model on the axial slice through its middle, and the errors of all phases.

    Attributes:
        mesh_mm: (s, 2, 2) segments of the surface that the spline was fitted to, left and back (LPS), mm.
        mesh_error_mm: (s, 2) distance of the fitted surface from their ends.
        x_mm, y_mm: (n,) left and back of the samples.
        potential: (n, n) sigmoid potential of the fitted spline, rows along y; 0.5 is the fitted surface.
        errors_mm: (k,) distance of the fitted surface from random points of the original, all phases.
    """

    mesh_mm: FloatArray
    mesh_error_mm: FloatArray
    x_mm: FloatArray
    y_mm: FloatArray
    potential: FloatArray
    errors_mm: FloatArray


def surface_fit(
    model: DvfModel,
    *,
    phase: int,
    rng: np.random.Generator,
    points_per_phase: int = 2000,
    pitch_mm: float = 0.25,
) -> SurfaceFit:
    """Sample a model for `surface_figure`.

    Args:
        model: the model, with the surfaces it was fitted to.
        phase: the phase of the slice.
        rng: draws the points at which the surfaces are compared.
        points_per_phase: number of points.
        pitch_mm: between samples of the slice.
    """
    mesh = model.reference[phase]
    low, high = mesh.vertices_mm.min(axis=0), mesh.vertices_mm.max(axis=0)
    # avoids a plane through a vertex, which would give segments twice
    level = 0.5 * float(low[2] + high[2]) + 1e-3
    room = np.minimum(low - model.origin_mm, model.upper_mm - high)[:2].min() - 1e-6
    beyond = min(5.0, float(room))
    x, y = (np.arange(low[a] - beyond, high[a] + beyond, pitch_mm) for a in (0, 1))
    across, along = np.meshgrid(x, y)
    points = np.column_stack([across.ravel(), along.ravel(), np.full(across.size, level)])
    spline = SplineField.of_model(model, phase)
    distance, _ = spline.at(points)
    segments = plane_section(mesh.vertices_mm[mesh.triangles], 2, level)
    miss, slope = spline.at(segments.reshape(-1, 3))
    errors = [phase_errors(model, k, points_per_phase, rng).surface_mm for k in range(model.phases)]
    return SurfaceFit(
        mesh_mm=segments[..., :2],
        mesh_error_mm=(np.abs(miss) / np.linalg.norm(slope, axis=1)).reshape(-1, 2),
        x_mm=x,
        y_mm=y,
        potential=Sigmoid().potential(distance).reshape(across.shape),
        errors_mm=np.concatenate(errors),
    )


def surface_figure(fit: SurfaceFit) -> Figure:
    """Draw both surfaces on a slice, enlarged at their largest distance, and the spread of distances."""
    figure = Figure(figsize=(12.5, 4.6), layout="constrained")
    whole, near, spread = figure.subplots(1, 3, width_ratios=(1.1, 1.1, 1.0))
    center = fit.mesh_mm.reshape(-1, 2)[int(np.argmax(fit.mesh_error_mm))]
    for axis in (whole, near):
        _draw_surfaces(axis, fit)
    low, high = center - 0.5 * SHOWN_MM, center + 0.5 * SHOWN_MM
    near.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
    whole.add_patch(Rectangle((low[0], low[1]), SHOWN_MM, SHOWN_MM, fill=False, ec=TRUTH, lw=1.0, ls="--"))
    whole.set_title("axial slice, end-diastole", fontsize=10)
    near.set_title(f"{SHOWN_MM:g} mm about the point of largest distance", fontsize=10)
    _draw_errors(spread, fit.errors_mm)
    handles = [
        whole.plot([], [], color=color, lw=width, label=label)[0]
        for color, width, label in (
            (TRUTH, 2.4, "original surface"),
            (ESTIMATE, 1.2, "fitted surface, potential 0.5"),
        )
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _draw_surfaces(axis: Axes, fit: SurfaceFit) -> None:
    axis.add_collection(LineCollection(list(fit.mesh_mm), colors=TRUTH, linewidths=2.4, alpha=0.55))
    axis.contour(fit.x_mm, fit.y_mm, fit.potential, levels=[0.5], colors=[ESTIMATE], linewidths=1.2)
    axis.set(xlabel="left, mm", ylabel="back, mm", aspect="equal")
    axis.set(xlim=(fit.x_mm[0], fit.x_mm[-1]), ylim=(fit.y_mm[-1], fit.y_mm[0]))


def _draw_errors(axis: Axes, errors_mm: FloatArray) -> None:
    mean, sd = float(errors_mm.mean()), float(errors_mm.std())
    top = max(1.0, 1.05 * float(np.percentile(errors_mm, 99.5)))
    axis.hist(
        np.minimum(errors_mm, top), bins=np.linspace(0.0, top, 51).tolist(), color=ESTIMATE,
        weights=np.full(len(errors_mm), 100.0 / len(errors_mm)), label=f"here: {mean:.2f} ± {sd:.2f} mm",
    )  # fmt: skip
    label = f"Ren 2008: {PAPER_MEAN_MM:g} ± {PAPER_SD_MM:g} mm"
    axis.axvspan(PAPER_MEAN_MM - PAPER_SD_MM, PAPER_MEAN_MM + PAPER_SD_MM, color=TRUTH, alpha=0.12, lw=0)
    axis.axvline(PAPER_MEAN_MM, color=TRUTH, lw=1.2, ls="--", label=label)
    axis.set(xlabel="distance between the surfaces, mm", ylabel="share of the surface, %", xlim=(0.0, top))
    axis.set_title("all phases, random points", fontsize=10)
    axis.legend(fontsize=9, loc="upper right", framealpha=1.0, edgecolor="none")
    open_frame(axis)
