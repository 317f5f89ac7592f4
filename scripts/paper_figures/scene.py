"""Draw the heart in space with pellets and tool: Ren 2008, Figs 7, 12 and 13."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from dvf_ig.core import FloatArray, IntArray, read_only_arrays
from dvf_ig.report.style import BLUES, TRUTH, open_frame

HEART, PELLET, TOOL = "#d98a6a", "#2456c8", "#555b63"
SECTION_MM = 14.0
"""Half the side of the section that is drawn."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class HeartView:
    """A heart from one side.

    Attributes:
        vertices_mm: (v, 3); triangles: (t, 3).
        toward: (3,) unit vector to the eye.
        pellets_mm: (n, 3).
        tool_mm: (k, 3) its line from the tip on, at least two; what lies between is marked.
    """

    vertices_mm: FloatArray
    triangles: IntArray
    toward: FloatArray
    pellets_mm: FloatArray
    tool_mm: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Surface and tip at one time, in the plane of a section about the tip's first place.

    Attributes:
        name: of the time.
        surface_mm: (s, 2, 2) segments; tip_mm: (2,).
    """

    name: str
    surface_mm: FloatArray
    tip_mm: FloatArray


def scene_figure(view: HeartView, title: str) -> Figure:
    """Draw one view."""
    figure = Figure(figsize=(6.4, 5.8))
    _draw(figure.add_axes((0.0, 0.0, 1.0, 0.93), projection="3d", computed_zorder=False), view)
    figure.suptitle(title, fontsize=11)
    return figure


def held_figure(view: HeartView, sections: Sequence[Section], title: str) -> Figure:
    """Draw a view, and sections of the beating surface with the tip held to it."""
    figure = Figure(figsize=(10.5, 5.0))
    _draw(figure.add_axes((0.0, 0.0, 0.48, 0.93), projection="3d", computed_zorder=False), view)
    axis = figure.add_axes((0.56, 0.13, 0.42, 0.76))
    for section, color in zip(sections, BLUES, strict=False):
        axis.add_collection(LineCollection(list(section.surface_mm), colors=color, linewidths=2.0))
        axis.plot(*section.tip_mm, "o", ms=8, mfc="white", mec=color, mew=2.5, label=section.name, zorder=3)
    axis.set(xlim=(-SECTION_MM, SECTION_MM), ylim=(-SECTION_MM, SECTION_MM), aspect="equal")
    axis.set(xlabel="along the surface, mm", ylabel="outwards, mm")
    axis.legend(frameon=False, fontsize=9, loc="lower left")
    axis.set_title("section through the tip: surface and tip through the beat", fontsize=10)
    open_frame(axis)
    figure.suptitle(title, fontsize=11)
    return figure


def _draw(axis: Any, view: HeartView) -> None:
    corners = view.vertices_mm[view.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    facing = normals @ view.toward
    light = view.toward + np.array([0.0, 0.0, 0.6])
    shade = 0.35 + 0.65 * np.clip(normals @ (light / np.linalg.norm(light)), 0.0, 1.0)
    front = facing > -0.05
    colors = np.clip(shade[front, None] * np.array(to_rgb(HEART)), 0.0, 1.0)
    heart = Poly3DCollection(corners[front], facecolors=colors, edgecolors=colors, linewidths=0.3, zorder=1)
    axis.add_collection3d(heart)
    if len(view.pellets_mm):
        axis.scatter(
            *view.pellets_mm.T, s=70, c=PELLET, edgecolors="white", linewidths=0.8, depthshade=False, zorder=3
        )
    axis.plot(*view.tool_mm.T, color=TOOL, lw=4.0, solid_capstyle="round", zorder=4)
    axis.scatter(*view.tool_mm[:1].T, s=45, c="white", edgecolors=TRUTH, depthshade=False, zorder=5)
    for place in view.tool_mm[1:-1]:
        axis.scatter(*place, s=90, marker="D", c="#f0e442", edgecolors=TRUTH, depthshade=False, zorder=5)
    x, y, z = view.toward
    across = np.cross([0.0, 0.0, 1.0], view.toward)
    shown = np.concatenate([view.vertices_mm, view.tool_mm[:2]])
    middle = 0.5 * (shown.min(axis=0) + shown.max(axis=0))
    upwards = np.cross(view.toward, across / np.linalg.norm(across))
    half = 0.5 * max(float(np.ptp(shown @ way)) for way in (across / np.linalg.norm(across), upwards))
    axis.set(
        xlim=(middle[0] - half, middle[0] + half),
        ylim=(middle[1] - half, middle[1] + half),
        zlim=(middle[2] - half, middle[2] + half),
    )
    axis.set_proj_type("ortho")
    axis.set_box_aspect((1.0, 1.0, 1.0), zoom=1.4)
    axis.set_axis_off()
    axis.view_init(elev=float(np.rad2deg(np.arcsin(z))), azim=float(np.rad2deg(np.arctan2(y, x))))
