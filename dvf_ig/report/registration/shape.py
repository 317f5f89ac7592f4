"""Picture of a heart that has changed its shape: the patient's surface beside that of the MR."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dvf_ig.core import BoolArray, FloatArray, IntArray, Mesh, Warp, read_only_arrays
from dvf_ig.report.style import WIDE_IN
from dvf_ig.report.viewer.surfaces import normal_shifts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

UNKNOWN = (0.72, 0.72, 0.72)
MR = (0.93, 0.90, 0.85)
SHIFTS = "RdBu_r"
DARKEST = 0.35
"""Brightness of a triangle seen from its side."""
VIEWS = (("from the front", 1.0), ("from behind", -1.0))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ShapeShown:
    """The surface in the MR and that of the patient, at one phase, LPS.

    Attributes:
        sentence: the change in words.
        before_mm, now_mm: (v, 3); triangles: (t, 3).
        outward_mm: (v,) shift along the normal.
        known: (v,) the wall's place is known well enough for a force.
    """

    sentence: str
    before_mm: FloatArray
    now_mm: FloatArray
    triangles: IntArray
    outward_mm: FloatArray
    known: BoolArray


def shape_shown(sentence: str, mesh: Mesh, warp: Warp, largest_sigma_mm: float) -> ShapeShown:
    """Move a surface of the MR to where the patient has it.

    Args:
        largest_sigma_mm: of a place that counts as known.
    """
    before = mesh.vertices_mm
    now = warp.patient_places(before)
    outward, sigma_mm = normal_shifts(mesh, now, warp)
    certain = sigma_mm <= largest_sigma_mm
    return ShapeShown(sentence, before, now, np.asarray(mesh.triangles), outward, certain)


def shape_figure(shape: ShapeShown) -> Figure:
    """Draw both surfaces from the front and from behind, the patient's coloured by its shift."""
    figure = Figure(figsize=(WIDE_IN, 3.4), layout="constrained")
    axes = figure.subplots(1, 4)
    largest = max(1.0, float(np.abs(shape.outward_mm[shape.known]).max(initial=0.0)))
    scale = Normalize(-largest, largest)
    shift = colormaps[SHIFTS](scale(shape.outward_mm[shape.triangles].mean(axis=1)))[:, :3]
    certain = np.asarray(shape.known.take(shape.triangles).all(axis=1))
    color = np.where(certain[:, None], shift, UNKNOWN)
    plain = np.broadcast_to(np.array(MR), color.shape)
    for column, (view, side) in enumerate(VIEWS):
        for axis, name, places, colors in (
            (axes[2 * column], "in the MR", shape.before_mm, plain),
            (axes[2 * column + 1], "now", shape.now_mm, color),
        ):
            _draw(axis, places[shape.triangles], colors, side)
            axis.set_title(f"{name}, {view}", fontsize=9)
    bar = figure.colorbar(ScalarMappable(scale, SHIFTS), ax=axes, shrink=0.8, pad=0.01)
    bar.set_label("further out, mm; grey: not known")
    return figure


def _draw(axis: Axes, corners_mm: FloatArray, colors: FloatArray, side: float) -> None:
    """Draw (t, 3, 3) triangles as seen along y, the far ones first.

    Args:
        side: 1 from the front, −1 from behind.
    """
    normal = np.cross(corners_mm[:, 1] - corners_mm[:, 0], corners_mm[:, 2] - corners_mm[:, 0])
    facing = -side * normal[:, 1] / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    order = np.argsort(-side * corners_mm[:, :, 1].mean(axis=1))
    order = order[facing[order] > 0.0]
    bright = DARKEST + (1.0 - DARKEST) * facing[order, None]
    flat = corners_mm[order][:, :, [0, 2]] * np.array([side, 1.0])
    shaded = np.clip(colors[order] * bright, 0.0, 1.0)
    axis.add_collection(PolyCollection(list(flat), facecolors=shaded, edgecolors=shaded, linewidths=0.3))
    axis.autoscale_view()
    axis.set_aspect("equal")
    axis.set_axis_off()
    for place, letter in ((0.02, "R" if side > 0 else "L"), (0.98, "L" if side > 0 else "R")):
        axis.text(place, 0.02, letter, transform=axis.transAxes, fontsize=8, ha="center", color="#555555")
