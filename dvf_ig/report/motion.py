"""Draw a propagated surface: end-diastole and end-systole with contours, and quality by phase.

matplotlib is loaded when a picture is written.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import map_coordinates

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.space.mesh import SurfaceSeries
from dvf_ig.core.space.volume import VolumeSeries

from .plane_section import plane_section
from .style import ESTIMATE, FAINT, ON_GREY, START, TRUTH, without_ticks, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dvf_ig.preop.motion.quality import MotionQuality

BEYOND_MM = 15.0
PIXEL_MM = 1.0
_VIEWS = (("across axis k", 2), ("across axis j", 1), ("across axis i", 0))


def write_motion_picture(
    path: Path | str,
    image: VolumeSeries,
    surfaces: SurfaceSeries,
    quality: MotionQuality,
    *,
    ed_phase: int,
    es_phase: int,
) -> None:
    """Write three planes through the organ at end-diastole and end-systole, and bars of quality, as a PNG.

    Raises:
        InvalidInputError: a suffix that is not .png.
        OutputError: not writable.
    """
    write_png(path, motion_figure(image, surfaces, quality, ed_phase, es_phase), dpi=90)


def motion_figure(
    image: VolumeSeries, surfaces: SurfaceSeries, quality: MotionQuality, ed_phase: int, es_phase: int
) -> Figure:
    """Draw three planes at both phases above, the quality of the motion by phase below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 10.5), layout="constrained")
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=(3.0, 1.6))[:, 0]
    axes = upper.subplots(2, 3)
    index = image.grid.to_index(surfaces.vertices_mm)
    low, high = index.min(axis=(0, 1)), index.max(axis=(0, 1))
    for row, (word, phase) in enumerate((("end-diastole", ed_phase), ("end-systole", es_phase))):
        for axis, (view, normal) in zip(axes[row], _VIEWS, strict=True):
            _draw_plane(axis, image, surfaces, (phase, ed_phase), normal, (low, high))
            percent = 100 * image.timing.fractions[phase]
            axis.set_title(f"{word} ({percent:.0f} % of the cycle), {view}", fontsize=9, color=TRUTH)
    upper.suptitle("propagated surface (dotted: end-diastole)", fontsize=10, color=TRUTH)
    bars = lower.subplots(2, 2).ravel()
    _draw_bars(bars, image, quality, es_phase)
    lower.legend(
        *bars[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=9
    )
    return figure


def _draw_plane(
    axis: Axes,
    image: VolumeSeries,
    surfaces: SurfaceSeries,
    phases: tuple[int, int],
    normal: int,
    box: tuple[FloatArray, FloatArray],
) -> None:
    """Draw a plane of voxels in mm, the contour of the phase and, dotted, that of end-diastole."""
    from matplotlib.collections import LineCollection

    grid, spacing = image.grid, image.grid.spacing_mm
    level = round(float(0.5 * (box[0] + box[1])[normal]))
    across, up = (a for a in range(3) if a != normal)
    low = np.maximum(box[0] * spacing - BEYOND_MM, 0.0)
    high = np.minimum(box[1] * spacing + BEYOND_MM, (np.array(grid.shape) - 1) * spacing)
    x, y = (np.arange(low[a], high[a] + 1e-6, PIXEL_MM) for a in (across, up))
    at = np.empty((3, len(y), len(x)))
    at[normal], at[across], at[up] = level, x / spacing[across], (y / spacing[up])[:, None]
    grey = map_coordinates(image.values[phases[0]].astype(np.float64), at, order=1, mode="nearest")
    top = float(np.percentile(grey, 99.5))
    extent = (x[0], x[-1], y[0], y[-1])
    axis.imshow(grey, cmap="gray", vmin=0.0, vmax=max(top, 1e-9), origin="lower", extent=extent)
    for phase, style, colour in ((phases[1], ":", FAINT), (phases[0], "-", ON_GREY)):
        mesh = surfaces.phase(phase)
        lines = plane_section(grid.to_index(mesh.vertices_mm)[mesh.triangles], normal, level + 1e-3)
        segments = (lines * spacing)[..., [across, up]]
        axis.add_collection(LineCollection(list(segments), colors=colour, linewidths=1.2, linestyles=style))
    without_ticks(axis)


def _draw_bars(axes: list[Axes], image: VolumeSeries, quality: MotionQuality, es_phase: int) -> None:
    from matplotlib.ticker import MaxNLocator

    shown = [
        ("correlation with end-diastole", quality.correlation_before, quality.correlation),
        ("smallest local volume ratio (folds at 0)", None, quality.min_jacobian),
        ("mean motion of the organ, mm", None, quality.mean_motion_mm),
    ]
    if quality.dice is not None:
        shown.append(("overlap with labels (Dice)", quality.dice_before, quality.dice))
    else:
        shown.append(("RMS difference left, share of the grey-level spread", None, quality.residual))
    phases = np.arange(len(image.timing))
    for axis, (title, before, after) in zip(axes, shown, strict=True):
        if before is not None:
            axis.bar(phases, before, color=FAINT, label="without motion")
        axis.bar(phases, after, color=ESTIMATE, width=0.5, label="after the motion")
        axis.axvline(es_phase, color=START, linewidth=1.0, linestyle=":")
        axis.set_title(title, fontsize=9, color=TRUTH)
        axis.tick_params(labelsize=8)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.set_xlim(-0.7, len(phases) - 0.3)
    for axis in axes[2:]:
        axis.set_xlabel("phase (dotted: end-systole)", fontsize=8)
