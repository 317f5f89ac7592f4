"""Draw a scenario: the pre-operative heart over its cycle, ultrasound over the sweep, the ECG."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import map_coordinates

from dvf_ig.core import AnyArray, FloatArray, Grid, Preop, Scenario, TriggerTimes, Volume, VolumeSeries

from .style import ON_GREY, TRUTH, png_bytes, without_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PHASES = 5
FRAMES = 10
ECG_S = 10.0
HALF_MM, PITCH_MM = 78.0, 1.5
"""Half the size of the planes through the heart, and their pixels."""
CUT_MM = 1.5
"""Largest distance from a plane of the surface vertices that are drawn."""

_VIEWS = (("axial", 2), ("coronal", 1), ("sagittal", 0))


def preview_png(scenario: Scenario) -> bytes:
    """Draw the contact sheet as a PNG."""
    return png_bytes(preview(scenario), dpi=90)


def preview(scenario: Scenario) -> Figure:
    """Draw three views by PHASES phases, FRAMES ultrasound images, and the first seconds of the ECG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 13.0), layout="constrained")
    upper, middle, lower = figure.subfigures(3, 1, squeeze=False, height_ratios=(6.6, 4.6, 1.5))[:, 0]
    upper.suptitle(scenario.name)
    _draw_preop(upper.subplots(3, PHASES), scenario.preop)
    images = scenario.ultrasound.images
    if images is not None:
        t_s = scenario.ultrasound.t_s
        chosen = np.unique(np.linspace(0, len(images) - 1, FRAMES).astype(int))
        axes = middle.subplots(2, FRAMES // 2).ravel()
        for axis, i in zip(axes, chosen.tolist(), strict=False):
            axis.imshow(images[i], cmap="gray", vmin=0, vmax=255)
            axis.set_title(f"ultrasound, {t_s[i]:.1f} s", fontsize=9)
        without_ticks(*axes)
    _draw_ecg(lower.subplots(), scenario)
    return figure


def _draw_preop(axes: AnyArray, preop: Preop) -> None:
    shown = preop.mr or preop.labels
    timing = (shown or preop.surfaces[0]).timing
    phases = np.linspace(0, len(timing), PHASES, endpoint=False).astype(int).tolist()
    center = _heart_center(preop)
    for column, phase in enumerate(phases):
        axes[0, column].set_title(f"{100 * timing.fractions[phase]:.0f} % of the cycle", fontsize=9)
        for row, (_, normal) in enumerate(_VIEWS):
            if shown is not None:
                _draw_slice(axes[row, column], shown, preop, phase, center, normal)
            else:
                _draw_cut(axes[row, column], preop, phase, center, normal)
    without_ticks(*axes.ravel())
    for row, (name, _) in enumerate(_VIEWS):
        axes[row, 0].set_ylabel(f"{name}, pre-operative", fontsize=9)


def _labels(preop: Preop, phase: int) -> Volume | None:
    """Return the labels at a phase; None if there are none."""
    if preop.labels is not None and phase < len(preop.labels.timing):
        return Volume(preop.labels.grid, preop.labels.values[phase])
    return preop.ed_labels if phase == preop.ed_phase else None


def _heart_center(preop: Preop) -> FloatArray:
    """Return the (3,) middle of the organ at end-diastole, frame "mr"."""
    labelled = _labels(preop, preop.ed_phase)
    if labelled is not None:
        where = np.argwhere(np.isin(labelled.values, preop.organ_labels))
        if len(where):
            return labelled.grid.to_mm(0.5 * (where.min(axis=0) + where.max(axis=0)))
    if preop.surfaces:
        return np.asarray(preop.surfaces[0].vertices_mm[0].mean(axis=0))
    return np.zeros(3)


def _draw_slice(
    axis: Axes, shown: VolumeSeries, preop: Preop, phase: int, center: FloatArray, normal: int
) -> None:
    """Draw a plane in LPS through the heart's centre, for any voxel axes, with the organ's outline."""
    values = _plane(shown.values[phase], shown.grid, center, normal)
    extent = (-HALF_MM, HALF_MM, -HALF_MM, HALF_MM)
    top = max(float(np.percentile(shown.values[0], 99.7)), 1.0)
    axis.imshow(values, cmap="gray", vmin=0, vmax=top, origin="lower", extent=extent)
    labelled = _labels(preop, phase)
    if labelled is not None:
        organ = np.isin(labelled.values, preop.organ_labels).astype(np.float32)
        outline = _plane(organ, labelled.grid, center, normal)
        if outline.min() < 0.5 < outline.max():
            axis.contour(outline, levels=[0.5], colors=[ON_GREY], linewidths=0.9, extent=extent)
    _head_up(axis, normal)


def _plane(values: AnyArray, grid: Grid, center: FloatArray, normal: int) -> FloatArray:
    """Sample (n, n) values on the plane through `center`; rows run along the later of the two LPS axes."""
    steps = np.arange(-HALF_MM, HALF_MM + 0.5 * PITCH_MM, PITCH_MM)
    a, b = (k for k in range(3) if k != normal)
    points = np.tile(center, (len(steps), len(steps), 1))
    points[..., a] += steps
    points[..., b] += steps[:, None]
    index = grid.to_index(points.reshape(-1, 3))
    seen = map_coordinates(values.astype(np.float32), index.T, order=1, cval=0.0)
    return np.asarray(seen.reshape(len(steps), -1), dtype=np.float64)


def _head_up(axis: Axes, normal: int) -> None:
    """Flip axial views, so that they show the front at the top; the others show the head."""
    if normal == 2:
        axis.invert_yaxis()


def _draw_cut(axis: Axes, preop: Preop, phase: int, center: FloatArray, normal: int) -> None:
    """Draw surface vertices near the plane, if there is no image."""
    a, b = (k for k in range(3) if k != normal)
    for series in preop.surfaces:
        vertices = series.vertices_mm[phase % len(series.vertices_mm)] - center
        near = vertices[np.abs(vertices[:, normal]) < CUT_MM]
        axis.plot(near[:, a], near[:, b], ".", ms=1.5)
    axis.set(aspect="equal", xlim=(-HALF_MM, HALF_MM), ylim=(-HALF_MM, HALF_MM))
    _head_up(axis, normal)


def _draw_ecg(axis: Axes, scenario: Scenario) -> None:
    ecg = scenario.ecg
    shown = ecg.t_s < ecg.start_s + ECG_S
    if isinstance(ecg, TriggerTimes):
        axis.vlines(ecg.t_s[shown], 0.0, 1.0, color=TRUTH, lw=0.8)
        axis.set(xlabel="time, s", ylabel="trigger", yticks=[])
    else:
        axis.plot(ecg.t_s[shown], ecg.samples[shown, 0], color=TRUTH, lw=0.8)
        axis.set(xlabel="time, s", ylabel=f"{ecg.leads[0]}, {ecg.unit}")
    axis.margins(x=0)
