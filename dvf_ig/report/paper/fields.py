"""Draw the force of a fixture on a slice: Ren 2008, Figs 5 (forbidden region) and 11 (guidance).

Every colour and arrow is a force from the evaluator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dvf_ig.core import DvfModel, FloatArray, read_only_arrays
from dvf_ig.guidance import Evaluator
from dvf_ig.report.style import OUTLINE, TRUTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

NEAR_MM = 12.0
"""Half the side of the enlarged square."""
PIXELS = 320


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SliceField:
    """Forces on an axial square.

    Attributes:
        center_mm: (3,) middle of the square.
        half_mm: half its side.
        xy_mm: (2, n, n) left and back (LPS) of the pixels; force_size_n, distance_mm: (n, n) there.
        arrow_xy_mm: (2, a, a) positions of the arrows; arrow_n: (a, a, 3) forces there.
        cap_n: largest force of the law.
    """

    center_mm: FloatArray
    half_mm: float
    xy_mm: FloatArray
    force_size_n: FloatArray
    distance_mm: FloatArray
    arrow_xy_mm: FloatArray
    arrow_n: FloatArray
    cap_n: float


def organ_field(evaluator: Evaluator, model_phase: float) -> SliceField:
    """Evaluate the axial slice through the middle of the organ, as far as the model reaches."""
    model = evaluator.model
    center, half = _slice_frame(model)
    return _field(evaluator, center, half, model_phase, arrows=25)


def surface_field(evaluator: Evaluator, model_phase: float) -> SliceField:
    """Evaluate a square at the left edge of the organ on the same slice."""
    center, half = _slice_frame(evaluator.model)
    place = _surface_point(evaluator, center, center + np.array([half, 0.0, 0.0]), model_phase)
    return _field(evaluator, place, NEAR_MM, model_phase, arrows=17)


def field_figure(whole: SliceField, near: SliceField, title: str) -> Figure:
    """Draw |F| as colour, F as arrows and the surface as a line, for the organ and near its surface.

    Args:
        whole, near: see `organ_field` and `surface_field`.
        title: of the figure.
    """
    figure = Figure(figsize=(11.5, 5.6), layout="constrained")
    axes = figure.subplots(1, 2)
    image = _draw_field(axes[0], whole)
    _draw_field(axes[1], near)
    low, side = near.center_mm[:2] - near.half_mm, 2 * near.half_mm
    axes[0].add_patch(
        Rectangle((float(low[0]), float(low[1])), side, side, fill=False, ec=TRUTH, lw=1.0, ls="--")
    )
    axes[0].set_title("axial slice, end-diastole", fontsize=10)
    axes[1].set_title(f"{side:g} mm about the marked point", fontsize=10)
    bar = figure.colorbar(image, ax=axes, shrink=0.85, pad=0.01)
    bar.set_label("force, N")
    figure.suptitle(title)
    return figure


def _slice_frame(model: DvfModel) -> tuple[FloatArray, float]:
    """Return the middle of the organ and half the side of a square about it inside the model's box."""
    vertices = model.reference[0].vertices_mm
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    room = np.minimum(center - model.origin_mm, model.upper_mm - center)[:2]
    return center, float(room.min()) - 0.5


def _surface_point(
    evaluator: Evaluator, inner: FloatArray, outer: FloatArray, model_phase: float
) -> FloatArray:
    """Find the last point at which the segment leaves the organ."""
    along = inner + np.linspace(0.0, 1.0, 2001)[:, None] * (outer - inner)
    distance = evaluator.force(along, model_phase).distance_mm
    return np.asarray(along[int(np.flatnonzero(distance > 0.0)[-1])])


def _field(
    evaluator: Evaluator, center: FloatArray, half: float, model_phase: float, *, arrows: int
) -> SliceField:
    # arrows start in the middle of equal squares
    inner = half * (1.0 - 1.0 / arrows)
    xy, force, distance = _on_square(evaluator, center, half, PIXELS, model_phase)
    arrow_xy, arrow_n, _ = _on_square(evaluator, center, inner, arrows, model_phase)
    size = np.linalg.norm(force, axis=2)
    return SliceField(center, half, xy, size, distance, arrow_xy, arrow_n, evaluator.law.cap_n)


def _on_square(
    evaluator: Evaluator, center: FloatArray, half: float, count: int, model_phase: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (2, n, n) coordinates, and (n, n, 3) forces and (n, n) distances there."""
    steps = np.linspace(-half, half, count)
    x, y = np.meshgrid(center[0] + steps, center[1] + steps)
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, center[2])])
    samples = evaluator.force(points, model_phase)
    return (
        np.stack([x, y]),
        samples.force_n.reshape(count, count, 3),
        samples.distance_mm.reshape(count, count),
    )


def _draw_field(axis: Axes, field: SliceField) -> AxesImage:
    """Draw a field with +x to the patient's left and +y to the back (LPS), front at the top."""
    half, (cx, cy) = field.half_mm, field.center_mm[:2].tolist()
    extent = (cx - half, cx + half, cy + half, cy - half)
    # rows of the arrays run to the back, like the axis
    image = axis.imshow(
        field.force_size_n, extent=extent, cmap=_pale_blues(), vmin=0.0, vmax=field.cap_n,
        interpolation="bilinear",
    )  # fmt: skip
    axis.contour(*field.xy_mm, field.distance_mm, levels=[0.0], colors=[OUTLINE], linewidths=2.2)
    force, (x, y) = field.arrow_n, field.arrow_xy_mm
    shown = np.linalg.norm(force, axis=2) > 0.02 * field.cap_n
    pitch = 2.0 * half / len(force)
    axis.quiver(
        x[shown], y[shown], force[shown][:, 0], force[shown][:, 1], angles="xy", scale_units="xy",
        scale=field.cap_n / (0.95 * pitch), width=0.0035, color=TRUTH, pivot="tail",
    )  # fmt: skip
    axis.set(xlabel="left, mm", ylabel="back, mm", xlim=extent[:2], ylim=extent[2:], aspect="equal")
    return image


def _pale_blues() -> ListedColormap:
    """Build a colour map from white to a blue on which black arrows are readable."""
    return ListedColormap(colormaps["Blues"](np.linspace(0.0, 0.62, 256)))
