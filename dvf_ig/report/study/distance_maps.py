"""Figure of the distance-map study: where each map errs, and what that does to the force.

Slices show map minus exact distance near the surface; bars show what is left after the spline fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from matplotlib.figure import Figure

from dvf_ig.core.arrays import FloatArray
from dvf_ig.report.style import ESTIMATE, TRUTH, open_frame, png_bytes, without_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN = (
    "dilation, 18 neighbours",
    "Euclidean on the mask, -h/2",
    "SimpleITK SignedMaurer, +h/2",
    "Gaussian, marching cubes, exact",
    "exact to the mesh",
)
RANGE_MM = 1.5


class MapScore(Protocol):
    """One way of making the map: its errors, and the (nx, ny, nz) map itself."""

    @property
    def name(self) -> str: ...
    @property
    def rms_wide_mm(self) -> float: ...
    @property
    def surface_mean_mm(self) -> float: ...
    @property
    def surface_sd_mm(self) -> float: ...
    @property
    def normal_median_deg(self) -> float: ...
    @property
    def normal_p95_deg(self) -> float: ...
    @property
    def distance_mm(self) -> FloatArray: ...


def distance_maps_png(
    scores: Sequence[MapScore], exact_mm: FloatArray, title: str, *, within_mm: float
) -> bytes:
    """The figure as a PNG file's bytes; see `distance_maps_figure`."""
    return png_bytes(distance_maps_figure(scores, exact_mm, title, within_mm=within_mm), dpi=100)


def distance_maps_figure(
    scores: Sequence[MapScore], exact_mm: FloatArray, title: str, *, within_mm: float
) -> Figure:
    """Slices of some maps' errors above, bars of all ways below.

    Args:
        scores: one a way; those named in SHOWN get a slice.
        exact_mm: (nx, ny, nz) exact distance.
        title: of the figure.
        within_mm: errors are drawn this close to the surface.
    """
    figure = Figure(figsize=(15.0, 8.2), layout="constrained")
    top, bottom = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.0, 1.1])[:, 0]
    shown = [score for score in scores if score.name in SHOWN]
    panels = top.subplots(1, len(shown), squeeze=False)[0]
    for axes, score in zip(panels, shown, strict=True):
        image = _slice(axes, exact_mm, score, within_mm)
    top.colorbar(image, ax=list(panels), label="map minus exact distance, mm", shrink=0.85)
    names = [score.name for score in scores]
    left, right = bottom.subplots(1, 2)
    _bars(
        left,
        names,
        [score.surface_mean_mm for score in scores],
        [score.surface_sd_mm for score in scores],
        "distance of the fitted surface from the mesh, mm (mean, line: + 1 SD)",
    )
    median = [score.normal_median_deg for score in scores]
    tail = [score.normal_p95_deg - m for score, m in zip(scores, median, strict=True)]
    _bars(right, names, median, tail, "error of the force's direction within 2 mm, ° (median, line: to p95)")
    right.set_yticklabels([])
    figure.suptitle(title)
    return figure


def _slice(axes: Axes, exact_mm: FloatArray, score: MapScore, within_mm: float) -> object:
    """Middle slice along the third axis."""
    middle = exact_mm.shape[2] // 2
    exact = exact_mm[:, :, middle]
    error = np.where(np.abs(exact) <= within_mm, score.distance_mm[:, :, middle] - exact, np.nan)
    image = axes.imshow(error.T, cmap="RdBu_r", vmin=-RANGE_MM, vmax=RANGE_MM, origin="lower")
    axes.contour(exact.T, levels=[0.0], colors=[TRUTH], linewidths=1.0)
    axes.set_title(f"{score.name}\nRMS {score.rms_wide_mm:.2f} mm within {within_mm:g} mm", fontsize=10)
    without_ticks(axes)
    return image


def _bars(axes: Axes, names: list[str], values: list[float], more: list[float], label: str) -> None:
    rows = np.arange(len(names))[::-1]
    whiskers = np.array([np.zeros(len(more)), more])
    axes.barh(rows, values, color=ESTIMATE, xerr=whiskers, error_kw={"ecolor": TRUTH, "lw": 1.2})
    axes.set_yticks(rows, names)
    axes.set_xlabel(label)
    for row, value, extra in zip(rows, values, more, strict=True):
        axes.annotate(
            f"{value:.3g}", (value + extra, row), xytext=(4, 0), textcoords="offset points", va="center"
        )
    axes.set_xlim(0.0, 1.15 * max(v + m for v, m in zip(values, more, strict=True)))
    open_frame(axes)
