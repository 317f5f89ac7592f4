"""The figures of Ren 2008, made from this model: potentials, force fields, a fixture over time.

Slices show the fixture itself: every colour and arrow is a force that the evaluator gave. Uses matplotlib.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dvf_ig.core import DvfModel, FloatArray
from dvf_ig.guidance import Evaluator, Gaussian, Law, Sigmoid, static_force
from dvf_ig.kernels.spline import spline_batch

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

INK, FAINT, WRONG, SURFACE = "#222222", "#9a9a9a", "#d1495b", "#d35400"
SHADES = ("#9ecae1", "#4a9bd0", "#1f6fb4", "#123f6e")
STEEPNESS_PER_MM = (0.5, 1.0, 2.0, 4.0)
EXPONENTS = (0.5, 1.0, 2.0, 4.0)
WIDTH_MM = 3.0


def sigmoid_figure() -> Figure:
    """Potential of the forbidden region, eq. 4, for several γ."""
    figure, axis = _potential_axes("Sigmoid potential of a forbidden region", "distance d, mm (inside +)")
    d = np.linspace(-6.0, 6.0, 601)
    for gamma, color in zip(STEEPNESS_PER_MM, SHADES, strict=True):
        law = Sigmoid(gamma)
        axis.plot(d, law.potential(d), color=color, lw=2.2, label=f"γ = {gamma:g} /mm")
    axis.axvspan(0.0, 6.0, color="#f3e3e3", lw=0, zorder=0)
    axis.annotate("inside the organ", (5.8, 0.04), ha="right", color="#8a4b4b", fontsize=9)
    axis.annotate("outside", (-0.2, 0.98), ha="right", color=FAINT, fontsize=9)
    axis.axhline(0.5, color=FAINT, lw=0.8, ls=":")
    axis.legend(frameon=False, loc="upper left")
    return figure


def gaussian_figure() -> Figure:
    """Potential of guidance, eq. 7, for several m at one δ."""
    figure, axis = _potential_axes("Generalised Gaussian potential of guidance", "distance to the target, mm")
    d = np.linspace(-8.0, 8.0, 1601)
    for m, color in zip(EXPONENTS, SHADES, strict=True):
        axis.plot(d, np.abs(Gaussian(WIDTH_MM, m).potential(d)), color=color, lw=2.2, label=f"m = {m:g}")
    reach = 1.0 - np.exp(-1.0)
    axis.plot([-WIDTH_MM, WIDTH_MM], [reach, reach], "o", ms=5, color=INK, zorder=5)
    axis.annotate(f"δ = {WIDTH_MM:g} mm: 63 %", (WIDTH_MM, reach), (8, -14), textcoords="offset points")
    axis.legend(frameon=False, loc="lower left")
    return figure


def field_figure(model: DvfModel, law: Law, title: str, *, model_phase: float = 0.0) -> Figure:
    """Force of a fixture on the axial slice through the middle of the organ, and close to its surface.

    Args:
        model: fixture.
        law: what pushes.
        title: of the figure.
        model_phase: place in the cycle.
    """
    evaluator = Evaluator(model, law)
    center, half = _slice_frame(model)
    figure = Figure(figsize=(11.5, 5.6), layout="constrained")
    axes = figure.subplots(1, 2)
    left = center + np.array([half, 0.0, 0.0])
    near = _surface_point(evaluator, center, left, model_phase)
    image = _draw_field(axes[0], evaluator, center, half, model_phase, arrows=25)
    _draw_field(axes[1], evaluator, near, 12.0, model_phase, arrows=17)
    low = near[:2] - 12.0
    axes[0].add_patch(_square(low, 24.0))
    axes[1].set_title("24 mm about the marked place", fontsize=10)
    axes[0].set_title("axial slice, end-diastole" if model_phase == 0.0 else "axial slice", fontsize=10)
    bar = figure.colorbar(image, ax=axes, shrink=0.85, pad=0.01)
    bar.set_label("force, N")
    figure.suptitle(title)
    return figure


def dynamic_figure(model: DvfModel, point_mm: FloatArray, law: Law, *, cycles: int = 2) -> Figure:
    """A fixture over time at a point that stays: distance, and force by eq. 10 corrected and as printed.

    Args:
        model: fixture.
        point_mm: (3,) place.
        law: what pushes.
        cycles: how many are drawn.
    """
    rr_s, count = model.timing.rr_s, model.phases
    phi = np.linspace(0.0, cycles, 2000 * cycles + 1)[:-1]
    points = np.tile(point_mm, (len(phi), 1))
    samples = Evaluator(model, law).force(points, phi)
    outward = -samples.gradient / np.linalg.norm(samples.gradient, axis=1)[:, None]
    corrected = np.einsum("ij,ij->i", samples.force_n, outward)
    printed = np.einsum("ij,ij->i", _as_printed(model, point_mm, law, phi), outward)
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.5))
    t = phi * rr_s
    upper.plot(t, samples.distance_mm, color=SHADES[2], lw=2.0)
    upper.axhline(0.0, color=INK, lw=0.8)
    upper.set(ylabel="distance, mm\n(inside +)", title=f"{count} volumes a cycle of {rr_s:g} s")
    upper.title.set_fontsize(10)
    # a line may not join what jumps: a gap at each frame switch
    switch = np.diff(np.searchsorted(model.timing.fractions, phi % 1.0, side="right"), prepend=0) != 0
    printed = np.where(switch, np.nan, printed)
    lower.plot(t, printed, color=WRONG, lw=1.2, label="eq. 10 as printed: αF(Vᵢ) + (1−α)F(Vᵢ₊₁)")
    lower.plot(t, corrected, color=SHADES[2], lw=2.0, label="corrected: (1−α)F(Vᵢ) + αF(Vᵢ₊₁)")
    lower.set(xlabel="time, s", ylabel="outward force, N", xlim=(0.0, cycles * rr_s))
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    for axis in (upper, lower):
        for beat in range(cycles):
            for fraction in model.timing.fractions:
                axis.axvline((beat + fraction) * rr_s, color="#e9e9e9", lw=0.7, zorder=0)
        axis.spines[["top", "right"]].set_visible(False)
    figure.suptitle("A forbidden region that beats, felt at a point that stays")
    return figure


def _potential_axes(title: str, x_label: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axis = figure.subplots()
    axis.set(xlabel=x_label, ylabel="potential f, share of the largest force", ylim=(0.0, 1.05), title=title)
    axis.spines[["top", "right"]].set_visible(False)
    axis.margins(x=0.0)
    return figure, axis


def _slice_frame(model: DvfModel) -> tuple[FloatArray, float]:
    """Middle of the organ and half the side of a square about it that stays inside the model's box."""
    vertices = model.reference[0].vertices_mm
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    room = np.minimum(center - model.origin_mm, model.upper_mm - center)[:2]
    return center, float(room.min()) - 0.5


def _surface_point(
    evaluator: Evaluator, inner: FloatArray, outer: FloatArray, model_phase: float
) -> FloatArray:
    """Where the segment last leaves the organ."""
    along = inner + np.linspace(0.0, 1.0, 2001)[:, None] * (outer - inner)
    distance = evaluator.force(along, model_phase).distance_mm
    return np.asarray(along[int(np.flatnonzero(distance > 0.0)[-1])])


def _draw_field(
    axis: Axes, evaluator: Evaluator, center: FloatArray, half: float, model_phase: float, *, arrows: int
) -> AxesImage:
    """|F| as colour, F as arrows, the surface as a line; +x is the patient's left, +y the back (LPS)."""
    extent = (center[0] - half, center[0] + half, center[1] + half, center[1] - half)
    xy, samples = _on_square(evaluator, center, half, 320, model_phase)
    size = np.linalg.norm(samples[0], axis=2)
    image = axis.imshow(
        size, extent=extent, cmap=_pale_blues(), vmin=0.0, vmax=evaluator.law.cap_n, interpolation="bilinear"
    )
    axis.contour(xy[0], xy[1], samples[1], levels=[0.0], colors=[SURFACE], linewidths=2.2)
    xy, samples = _on_square(evaluator, center, half * (1.0 - 1.0 / arrows), arrows, model_phase)
    force = samples[0]
    shown = np.linalg.norm(force, axis=2) > 0.02 * evaluator.law.cap_n
    pitch = 2.0 * half / arrows
    axis.quiver(
        xy[0][shown], xy[1][shown], force[shown][:, 0], force[shown][:, 1], angles="xy", scale_units="xy",
        scale=evaluator.law.cap_n / (0.95 * pitch), width=0.0035, color=INK, pivot="tail",
    )  # fmt: skip
    axis.set(xlabel="left, mm", ylabel="back, mm", xlim=extent[:2], ylim=extent[2:], aspect="equal")
    return image


def _pale_blues() -> ListedColormap:
    """White to a blue on which black arrows can be read."""
    return ListedColormap(colormaps["Blues"](np.linspace(0.0, 0.62, 256)))


def _on_square(
    evaluator: Evaluator, center: FloatArray, half: float, count: int, model_phase: float
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """(2, n, n) coordinates; (n, n, 3) forces and (n, n) distances there."""
    steps = np.linspace(-half, half, count)
    x, y = np.meshgrid(center[0] + steps, center[1] + steps)
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, center[2])])
    found = evaluator.force(points, model_phase)
    return np.stack([x, y]), (found.force_n.reshape(count, count, 3), found.distance_mm.reshape(count, count))


def _as_printed(model: DvfModel, point_mm: FloatArray, law: Law, phi: FloatArray) -> FloatArray:
    """(n, 3) eq. 10 with the weights as printed, α on the earlier volume."""
    forces = [_static(model, law, phase, point_mm) for phase in range(model.phases)]
    out = np.empty((len(phi), 3))
    for k, at in enumerate(phi.tolist()):
        first, second, alpha = model.timing.bracket(at)
        out[k] = alpha * forces[first] + (1.0 - alpha) * forces[second]
    return out


def _static(model: DvfModel, law: Law, phase: int, point_mm: FloatArray) -> FloatArray:
    distance, gradient, status = np.empty(1), np.empty((1, 3)), np.empty(1, dtype=np.int64)
    arguments = (model.coefficients, model.origin_mm, model.knot_spacing_mm, phase, point_mm[None].copy())
    spline_batch(*arguments, distance, gradient, status)
    return np.asarray(static_force(law, distance, gradient)[0])


def _square(low: FloatArray, side: float) -> Rectangle:
    return Rectangle((float(low[0]), float(low[1])), side, side, fill=False, ec=INK, lw=1.0, ls="--")
