"""Draw one slice of the heart: Ren 2008, Figs 3 (MR), 4 (distance), 5, 11 (potentials), 16 (ultrasound)."""

from dataclasses import dataclass

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from scipy.ndimage import distance_transform_cdt

from dvf_ig.core import BoolArray, FloatArray, read_only_arrays
from dvf_ig.report.style import ON_GREY


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Slice:
    """An image on a plane.

    Attributes:
        values: (rows, columns), rows downwards.
        extent_mm: left, right, bottom, top edge.
        contour_mm: (s, 2, 2) segments of the surface.
        across, down: what the axes are.
    """

    values: FloatArray
    extent_mm: tuple[float, float, float, float]
    contour_mm: FloatArray
    across: str = "left, mm"
    down: str = "back, mm"


def dilation_distance_mm(inside: BoolArray, spacing_mm: float) -> FloatArray:
    """Signed distance as the paper makes it: how many dilations reach a voxel, positive inside.

    Each dilation adds the voxels that share a face. Unlike a Euclidean distance it is too long by up to the
    square root of 3 along diagonals.
    """
    outwards = distance_transform_cdt(~inside, metric="taxicab").astype(np.float64)
    inwards = distance_transform_cdt(inside, metric="taxicab").astype(np.float64)
    return np.asarray(spacing_mm * (inwards - outwards + np.where(inside, -0.5, 0.5)))


def slice_figure(
    shown: Slice,
    title: str,
    label: str = "",
    *,
    limits: tuple[float, float] | None = None,
    force: tuple[FloatArray, FloatArray] | None = None,
) -> Figure:
    """Draw a slice in grey with the surface as a thin line.

    Args:
        label: of the grey scale; empty: none is drawn.
        limits: shown black and white.
        force: (a, 2) places and (a, 2) forces, N, drawn as arrows of 10 mm a newton.
    """
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    axis = figure.subplots()
    low, high = limits or (float(shown.values.min()), float(shown.values.max()))
    image = axis.imshow(
        shown.values, cmap="gray", extent=shown.extent_mm, vmin=low, vmax=high, interpolation="bilinear"
    )
    axis.add_collection(LineCollection(list(shown.contour_mm), colors=ON_GREY, linewidths=1.1))
    if force is not None:
        (x, y), (u, v) = force[0].T, force[1].T
        axis.quiver(x, y, u, v, angles="xy", scale_units="xy", scale=0.1, width=0.004, color="#f0e442")
    axis.set(xlabel=shown.across, ylabel=shown.down, aspect="equal")
    axis.set(xlim=shown.extent_mm[:2], ylim=shown.extent_mm[2:])
    axis.set_title(title, fontsize=11)
    if label:
        figure.colorbar(image, ax=axis, shrink=0.8, label=label)
    return figure
