"""Draw a propagated surface: end-diastole and end-systole with contours, and quality by phase.

matplotlib is loaded when a picture is written.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import map_coordinates

from dvf_ig.core import BoolArray, FloatArray, SurfaceSeries, VolumeSeries

from .plane_marks import draw_plane_marks, edge_letters, plane_name, viewed_upright
from .plane_overlay import plane_section
from .style import ESTIMATE, FAINT, MR_ON_GREY, ON_GREY, START, TRUTH, without_ticks, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dvf_ig.preop.motion.quality import MotionQuality

BEYOND_MM = 15.0
PIXEL_MM = 1.0
_NORMALS = (2, 1, 0)
"""Image axes across which the planes are drawn."""


def write_motion_picture(
    path: Path | str,
    image: VolumeSeries,
    surfaces: SurfaceSeries,
    quality: MotionQuality,
    *,
    ed_phase: int,
    es_phase: int,
    caps: BoolArray | None = None,
) -> None:
    """Write three planes through the organ at end-diastole and end-systole, and bars of quality, as a PNG.

    Args:
        caps: (t,) triangles that the image does not show: closed where it ends, or where no slice lies.
    Raises:
        InvalidInputError: a suffix that is not .png.
        OutputError: not writable.
    """
    write_png(path, motion_figure(image, surfaces, quality, ed_phase, es_phase, caps), dpi=90)


def motion_figure(
    image: VolumeSeries,
    surfaces: SurfaceSeries,
    quality: MotionQuality,
    ed_phase: int,
    es_phase: int,
    caps: BoolArray | None = None,
) -> Figure:
    """Draw three planes at both phases above, the quality of the motion by phase below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 10.5), layout="constrained")
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=(3.0, 1.6))[:, 0]
    axes = upper.subplots(2, 3)
    index = image.grid.to_index(surfaces.vertices_mm)
    low, high = index.min(axis=(0, 1)), index.max(axis=(0, 1))
    closed = np.zeros(len(surfaces.triangles), dtype=np.bool_) if caps is None else caps
    for row, (word, phase) in enumerate((("end-diastole", ed_phase), ("end-systole", es_phase))):
        for axis, normal in zip(axes[row], _NORMALS, strict=True):
            name = _draw_plane(axis, image, surfaces, (phase, ed_phase), normal, (low, high), closed)
            percent = 100 * image.timing.fractions[phase]
            axis.set_title(f"{word} ({percent:.0f} % of the cycle)\n{name}", fontsize=9, color=TRUTH)
    note = "; orange: not imaged, closed" if closed.any() else ""
    upper.suptitle(f"propagated surface (dotted: end-diastole{note})", fontsize=10, color=TRUTH)
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
    caps: BoolArray,
) -> str:
    """Draw a plane of voxels in mm as radiologists view it, with its contours; return the plane's name.

    The contour of the phase is solid, orange and dashed at caps; that of end-diastole is dotted.
    """
    from matplotlib.collections import LineCollection

    grid, spacing = image.grid, image.grid.spacing_mm
    level = round(float(0.5 * (box[0] + box[1])[normal]))
    plane = [a for a in range(3) if a != normal]
    column, row, *reverse = viewed_upright(grid.direction[:, plane].T)
    shown = [plane[column], plane[row]]
    low = np.maximum(box[0] * spacing - BEYOND_MM, 0.0)[shown]
    high = np.minimum(box[1] * spacing + BEYOND_MM, (np.array(grid.shape) - 1) * spacing)[shown]
    first, sign = np.where(reverse, high, low), np.where(reverse, -1.0, 1.0)
    x, y = (first[a] + sign[a] * np.arange(0.0, high[a] - low[a] + 1e-6, PIXEL_MM) for a in range(2))
    at = np.empty((3, len(y), len(x)))
    at[normal], at[shown[0]], at[shown[1]] = level, x / spacing[shown[0]], (y / spacing[shown[1]])[:, None]
    grey = map_coordinates(image.values[phases[0]].astype(np.float64), at, order=1, mode="nearest")
    top = float(np.percentile(grey, 99.5))
    width, height = (high - low).tolist()
    axis.imshow(grey, cmap="gray", vmin=0.0, vmax=max(top, 1e-9), extent=(0.0, width, height, 0.0))
    whole = np.ones_like(caps)
    parts = [(phases[1], whole, ":", FAINT), (phases[0], ~caps, "-", ON_GREY)]
    if caps.any():
        parts.append((phases[0], caps, "--", MR_ON_GREY))
    for phase, part, style, colour in parts:
        mesh = surfaces.phase(phase)
        lines = plane_section(grid.to_index(mesh.vertices_mm)[mesh.triangles[part]], normal, level + 1e-3)
        segments = ((lines * spacing)[..., shown] - first) * sign
        axis.add_collection(LineCollection(list(segments), colors=colour, linewidths=1.2, linestyles=style))
    directions = grid.direction[:, shown] * sign
    draw_plane_marks(axis, (width, height), edge_letters(directions[:, 0], directions[:, 1]))
    without_ticks(axis)
    return plane_name(grid.direction[:, normal])


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
