"""Draw a contact sheet of segmented N-wire images: dots, wires, and why frames were refused.

Candidate dots are thin orange rings; wires are light blue, filled, numbered in the phantom's order and joined
by pattern. matplotlib is loaded when a sheet is written.
"""

from __future__ import annotations

from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from dvf_ig.core.errors import InvalidInputError

from .style import ON_GREY, START, WRONG, png_path, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dvf_ig.calibration.wires.images import WireFrame, WireSegmentation
    from dvf_ig.core import AnyArray, TrackedSequence

COLUMNS, MOST_FOUND, MOST_REFUSED = 4, 12, 12


def write_wire_picture(
    path: Path | str, sequence: TrackedSequence, segmentation: WireSegmentation, *, title: str
) -> None:
    """Write up to MOST_FOUND frames with wires and up to MOST_REFUSED without, spread over the recording.

    Args:
        path: the PNG file.
        sequence: the images that were segmented.
        title: one line above the sheet.
    Raises:
        InvalidInputError: images of another recording, or a suffix that is not .png.
        OutputError: not writable.
    """
    path = png_path(path)
    if sequence.images is None or len(sequence.images) != len(segmentation.frames):
        raise InvalidInputError(
            f"the sequence has {0 if sequence.images is None else len(sequence)} images, the segmentation "
            f"{len(segmentation.frames)} frames; give the sequence that was segmented"
        )
    write_png(path, _sheet(sequence.images, segmentation, title), dpi=90)


def _sheet(images: AnyArray, segmentation: WireSegmentation, title: str) -> Figure:
    from matplotlib.figure import Figure

    shown = chosen_frames(segmentation)
    rows = -(-len(shown) // COLUMNS)
    aspect = images.shape[1] / images.shape[2]
    figure = Figure(figsize=(13.0, 0.6 + rows * (13.0 / COLUMNS * aspect + 0.3)), layout="constrained")
    figure.suptitle(title, fontsize=11)
    axes = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axis in axes:
        axis.set_axis_off()
    for axis, i in zip(axes, shown, strict=False):
        _draw(axis, images[i], segmentation.frames[i], i)
    return figure


def chosen_frames(segmentation: WireSegmentation) -> list[int]:
    """Choose frames for the sheet: some with wires, then some without, each spread over the recording."""
    has_wires = np.array([frame.found is not None for frame in segmentation.frames])
    return _spread(np.flatnonzero(has_wires), MOST_FOUND) + _spread(np.flatnonzero(~has_wires), MOST_REFUSED)


def _spread(indices: AnyArray, most: int) -> list[int]:
    if len(indices) <= most:
        return list(map(int, indices))
    return list(map(int, indices[np.linspace(0, len(indices) - 1, most).astype(int)]))


def _draw(axis: Axes, image: AnyArray, frame: WireFrame, number: int) -> None:
    axis.imshow(image, cmap="gray", vmin=0, vmax=max(32.0, float(np.percentile(image, 99.9))))
    axis.plot(*frame.dots.points_px.T, "o", mfc="none", mec=START, mew=0.7, ms=7)
    if frame.rejected is not None:
        text = fill(f"frame {number}: {frame.rejected.reason} ({frame.rejected.detail})", 52)
        axis.set_title(text, fontsize=8, color=WRONG)
    if frame.found is None:
        return
    for pattern in frame.found.points_px.reshape(-1, 3, 2):
        axis.plot(*pattern.T, "-", color=ON_GREY, lw=0.6)
    for k, (column, row) in enumerate(frame.found.points_px.tolist()):
        axis.plot(column, row, ".", color=ON_GREY, ms=3)
        axis.annotate(
            str(k + 1), (column, row), (4, 4), textcoords="offset points", color=ON_GREY, fontsize=7
        )
    axis.set_title(f"frame {number}: residual {frame.found.misfit_mm:.2f} mm", fontsize=8)
