"""Draw where the slices of an examination lie, and what shifts between their breath-holds do.

matplotlib is loaded when a picture is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import map_coordinates

from dvf_ig.core import FloatArray, Grid, VolumeSeries

from .plane_marks import draw_plane_marks, edge_letters
from .style import ESTIMATE, MR_ON_GREY, ON_GREY, SERIES, START, TRUTH, without_ticks, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from dvf_ig.preop import SliceShifts

BEYOND_MM = 25.0
"""How far beyond the heart a view is drawn."""
MOST_VIEWS = 5


def write_slices_picture(
    path: Path | str,
    sax: VolumeSeries,
    views: Sequence[VolumeSeries],
    names: Sequence[str],
    left_out: Sequence[str],
) -> None:
    """Write the stack's middle slice with the views that cut it, and each view with the slices that cut it.

    Args:
        names: of the views.
        left_out: sentences about series that were not taken.
    Raises:
        InvalidInputError: a suffix that is not .png.
        OutputError: not writable.
    """
    from matplotlib.figure import Figure

    shown = list(zip(views, names, strict=True))[:MOST_VIEWS]
    columns = 1 + len(shown)
    figure = Figure(figsize=(max(3.4 * columns, 7.0), 4.4 + 0.2 * len(left_out)), layout="constrained")
    axes = figure.subplots(1, columns, squeeze=False)[0]
    middle = sax.grid.shape[2] // 2
    plane = _slice_grid(sax.grid, middle)
    _draw_slice(axes[0], plane, sax.values[0, ..., middle])
    for (view, name), colour in zip(shown, SERIES, strict=False):
        _draw_line(axes[0], plane, view.grid, colour, name)
    axes[0].set_title(f"short-axis slice {middle} of {sax.grid.shape[2]}", fontsize=9, color=TRUTH)
    if shown:
        axes[0].legend(loc="lower left", fontsize=7)
    for axis, (view, name), colour in zip(axes[1:], shown, SERIES, strict=False):
        _draw_slice(axis, view.grid, view.values[0, ..., 0])
        for k in range(sax.grid.shape[2]):
            _draw_line(axis, view.grid, _slice_grid(sax.grid, k), MR_ON_GREY if k else ON_GREY, "")
        axis.set_title(name, fontsize=9, color=colour)
    note = f"{sax.grid.shape[2]} slices every {sax.grid.spacing_mm[2]:.1f} mm (blue: the first)"
    figure.suptitle(note, fontsize=10, color=TRUTH)
    if left_out:
        figure.supxlabel("left out: " + "\n".join(left_out), fontsize=8, color=START)
    write_png(path, figure)


def write_shifts_picture(
    path: Path | str,
    sax: VolumeSeries,
    view: VolumeSeries,
    shifts: SliceShifts,
    *,
    ed_phase: int,
    heart_mm: FloatArray,
) -> None:
    """Write a view next to what the stack shows in its plane, before and after the shifts, and the shifts.

    Args:
        view: the first of those that gave the shifts.
        heart_mm: (n, 3) vertices about which the view is drawn.
    Raises:
        InvalidInputError: a suffix that is not .png.
        OutputError: not writable.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 7.0), layout="constrained")
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=[2.0, 1.0])[:, 0]
    axes = upper.subplots(1, 3)
    own = int(np.argmin(np.abs((view.timing.fractions - sax.timing.fractions[ed_phase] + 0.5) % 1.0 - 0.5)))
    grid, part = _about(view.grid, heart_mm)
    _draw_slice(axes[0], grid, view.values[own, ..., 0][part])
    axes[0].set_title("long-axis view", fontsize=9)
    none = np.zeros_like(shifts.sax_mm)
    for axis, title, by_slice, by_view in (
        (
            axes[1],
            f"the stack in its plane, as acquired (correlation {shifts.before:.2f})",
            none,
            np.zeros(3),
        ),
        (axes[2], f"shifts taken out ({shifts.after:.2f})", shifts.sax_mm, shifts.views_mm[0]),
    ):
        _draw_slice(axis, grid, _stack_in(grid, sax, ed_phase, by_slice, by_view))
        axis.set_title(title, fontsize=9)
    upper.suptitle("end-diastole: one strip for each short-axis slice", fontsize=10, color=TRUTH)
    axis, slices = lower.subplots(), np.arange(len(shifts.sax_mm))
    along = shifts.sax_mm @ sax.grid.direction
    for column, (name, colour) in enumerate(
        zip(("rows", "columns", "normal"), (ESTIMATE, START, TRUTH), strict=True)
    ):
        axis.errorbar(
            slices + 0.1 * (column - 1),
            along[:, column],
            yerr=shifts.sax_sigma_mm[:, column],
            fmt="o",
            color=colour,
            label=f"along {name}",
        )
    axis.axhline(0.0, color=TRUTH, linewidth=0.6)
    axis.set_xlabel("slice"), axis.set_ylabel("shift, mm (± SD)")
    axis.legend(fontsize=8, ncols=3, frameon=False)
    write_png(path, figure, dpi=90)


def _about(grid: Grid, heart_mm: FloatArray) -> tuple[Grid, tuple[slice, slice]]:
    """The part of a slice about the heart, and its pixels."""
    index, margin = grid.to_index(heart_mm)[:, :2], BEYOND_MM / grid.spacing_mm[:2]
    low = np.maximum(np.floor(index.min(axis=0) - margin), 0.0).astype(int)
    high = np.minimum(np.ceil(index.max(axis=0) + margin) + 1.0, np.array(grid.shape[:2])).astype(int)
    (x, y), (end_x, end_y) = low.tolist(), high.tolist()
    origin = grid.to_mm(np.array([float(x), float(y), 0.0]))
    size = (end_x - x, end_y - y, 1)
    part = slice(x, end_x), slice(y, end_y)
    return Grid(grid.frame, size, origin, grid.spacing_mm, grid.direction), part


def _slice_grid(grid: Grid, k: int) -> Grid:
    size = (grid.shape[0], grid.shape[1], 1)
    return Grid(grid.frame, size, grid.to_mm(np.array([0.0, 0.0, float(k)])), grid.spacing_mm, grid.direction)


def _draw_slice(axis: Axes, grid: Grid, grey: Any) -> None:
    """Draw (nx, ny) grey levels of a slice in mm, with the patient's sides."""
    width, height = (np.array(grid.shape[:2]) * grid.spacing_mm[:2]).tolist()
    top = float(np.nanpercentile(grey, 99.5))
    axis.imshow(
        np.asarray(grey).T, cmap="gray", vmin=0.0, vmax=max(top, 1e-9), extent=(0.0, width, height, 0.0)
    )
    axis.set_facecolor("black")
    draw_plane_marks(axis, (width, height), edge_letters(grid.direction[:, 0], grid.direction[:, 1]))
    axis.set_xlim(0.0, width), axis.set_ylim(height, 0.0)
    without_ticks(axis)


def _draw_line(axis: Axes, shown: Grid, other: Grid, colour: str, label: str) -> None:
    """Draw where another slice, as far as it reaches, cuts the shown one."""
    along = np.cross(shown.direction[:, 2], other.direction[:, 2])
    size = float(np.linalg.norm(along))
    if size < 1e-3:
        return
    rows = np.stack([shown.direction[:, 2], other.direction[:, 2], along / size])
    middle = other.to_mm((np.array(other.shape) - 1.0) / 2.0)
    heights = [rows[0] @ shown.origin_mm, rows[1] @ other.origin_mm, rows[2] @ middle]
    start = np.linalg.solve(rows, np.array(heights))
    reach = 0.5 * float(np.linalg.norm(np.array(other.shape) * other.spacing_mm))
    points = start + np.linspace(-reach, reach, 200)[:, None] * rows[2]
    points = points[other.holds(np.column_stack([other.to_index(points)[:, :2], np.zeros(200)]))]
    if len(points):
        x, y = ((shown.to_index(points)[:, :2] + 0.5) * shown.spacing_mm[:2]).T
        axis.plot(x, y, color=colour, linewidth=1.0, label=label or None)


def _stack_in(
    view: Grid, sax: VolumeSeries, phase: int, by_slice: FloatArray, by_view: FloatArray
) -> FloatArray:
    """(nx, ny) grey levels of the stack's slices in a view's plane, each as a strip; NaN elsewhere."""
    i, j = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in view.shape[:2]), indexing="ij")
    points = view.to_mm(np.stack([i, j, np.zeros_like(i)], axis=-1)).reshape(-1, 3) - by_view
    out, nearest = np.full(len(points), np.nan), np.full(len(points), 0.5)
    for k, shift in enumerate(by_slice):
        index = sax.grid.to_index(points + shift)
        off = np.abs(index[:, 2] - k)
        take = (off < nearest) & sax.grid.holds(np.column_stack([index[:, :2], np.zeros(len(index))]))
        grey = sax.values[phase, ..., k].astype(np.float64)
        out[take] = map_coordinates(grey, index[take, :2].T, order=1, mode="nearest")
        nearest[take] = off[take]
    return out.reshape(view.shape[:2])
