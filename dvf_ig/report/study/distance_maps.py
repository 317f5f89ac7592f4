"""Picture of the distance-map study: where each map errs, and what that does to the force. Uses matplotlib.

Slices show map minus exact distance near the surface; bars show what is left after the spline fit.
"""

import io
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from dvf_ig.study.distance.maps import WIDE_MM, Comparison, MapScore

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


def distance_png(found: Comparison, title: str) -> bytes:
    """The picture as PNG bytes."""
    figure = Figure(figsize=(15.0, 8.2), layout="constrained")
    top, bottom = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.0, 1.1])[:, 0]
    shown = [score for score in found.scores if score.name in SHOWN]
    panels = top.subplots(1, len(shown), squeeze=False)[0]
    for axes, score in zip(panels, shown, strict=True):
        image = _slice(axes, found, score)
    top.colorbar(image, ax=list(panels), label="map minus exact, mm", shrink=0.85)
    names = [score.name for score in found.scores]
    left, right = bottom.subplots(1, 2)
    _bars(
        left,
        names,
        [score.surface_mean_mm for score in found.scores],
        [score.surface_sd_mm for score in found.scores],
        "fitted surface off the mesh, mm (mean, line: + 1 SD)",
    )
    median = [score.normal_median_deg for score in found.scores]
    tail = [score.normal_p95_deg - m for score, m in zip(found.scores, median, strict=True)]
    _bars(right, names, median, tail, "force direction within 2 mm, degrees (median, line: to p95)")
    right.set_yticklabels([])
    figure.suptitle(title)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    return buffer.getvalue()


def _slice(axes: "Axes", found: Comparison, score: MapScore) -> object:
    """Middle slice along the third axis."""
    middle = found.grid.shape[2] // 2
    exact = found.exact_mm[:, :, middle]
    error = np.where(np.abs(exact) <= WIDE_MM, score.distance_mm[:, :, middle] - exact, np.nan)
    image = axes.imshow(error.T, cmap="RdBu_r", vmin=-RANGE_MM, vmax=RANGE_MM, origin="lower")
    axes.contour(exact.T, levels=[0.0], colors="black", linewidths=1.0)
    axes.set_title(f"{score.name}\nRMS {score.rms_wide_mm:.2f} mm within 15 mm", fontsize=10)
    axes.set_xticks([])
    axes.set_yticks([])
    return image


def _bars(axes: "Axes", names: list[str], values: list[float], more: list[float], label: str) -> None:
    rows = np.arange(len(names))[::-1]
    whiskers = np.array([np.zeros(len(more)), more])
    axes.barh(rows, values, color="#1f6fb4", xerr=whiskers, error_kw={"ecolor": "#222222", "lw": 1.2})
    axes.set_yticks(rows, names)
    axes.set_xlabel(label)
    for row, value, extra in zip(rows, values, more, strict=True):
        axes.annotate(
            f"{value:.3g}", (value + extra, row), xytext=(4, 0), textcoords="offset points", va="center"
        )
    axes.set_xlim(0.0, 1.15 * max(v + m for v, m in zip(values, more, strict=True)))
    axes.spines[["top", "right"]].set_visible(False)
