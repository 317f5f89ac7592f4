"""One look for every figure: colours by what is shown, and figures as PNG and SVG.

Blue is what was estimated or taken, orange the start, the rival or what was left out, black the truth or the
reference. matplotlib is loaded by the modules that draw, not here.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.io.sidecar import MARK
from dvf_ig.io.writing.atomic import write_bytes

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ESTIMATE, START, TRUTH = "#1f6fb4", "#e07b00", "#222222"
WRONG = "#c43131"
"""What is refused, or wrong as printed."""
FAINT, GUIDE = "#b8b8b8", "#8a8a8a"
"""What stands behind for comparison; lines that guide the eye."""
REFUSED, SUSPENDED = "#d9d9d9", "#f6d5d2"
"""Shades of times without force, and of times in which the pose was suspended."""
ON_GREY = "#41b6e6"
"""Outlines over grey images, where blue is too dark."""
MR_ON_GREY = "#e69f00"
"""MR over grey ultrasound; told from ON_GREY by people with any colour blindness (Okabe and Ito 2008)."""
OUTLINE = "#d35400"
"""The surface over a field shaded blue."""
SERIES = (ESTIMATE, START, "#2a8c4a", "#8e44ad", "#7f6a55", WRONG)
"""One colour each for things of equal rank, ours first."""
BLUES = ("#9ecae1", "#4a9bd0", "#1f6fb4", "#123f6e")
"""One parameter that grows, pale to dark."""
DPI = 110
WIDE_IN = 10.5
"""Width of a figure that spans a page."""


def png_bytes(figure: Figure, dpi: int = DPI) -> bytes:
    """The figure as a PNG file's bytes; the same figure gives the same bytes."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": MARK})
    return buffer.getvalue()


def jpeg_bytes(figure: Figure, dpi: int = DPI) -> bytes:
    """The figure as a JPEG file's bytes: a fifth of a PNG's where speckle fills it."""
    buffer = BytesIO()
    figure.savefig(buffer, format="jpeg", dpi=dpi, pil_kwargs={"quality": 88, "subsampling": 0})
    return buffer.getvalue()


def svg_bytes(figure: Figure) -> bytes:
    """The figure as an SVG file's bytes; the same figure gives the same bytes."""
    from matplotlib import rc_context

    buffer = BytesIO()
    with rc_context({"svg.hashsalt": "dvf_ig"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def png_path(path: Path | str) -> Path:
    """The path, which ends in .png.

    Raises:
        InvalidInputError: another suffix.
    """
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InvalidInputError(f"{path} does not end in .png; pictures are written as PNG")
    return path


def write_png(path: Path | str, figure: Figure, dpi: int = DPI) -> None:
    """Write the figure whole or not at all.

    Raises:
        InvalidInputError: a suffix that is not .png.
        OutputError: not writable.
    """
    write_bytes(png_path(path), png_bytes(figure, dpi))


def time_axes(
    height_in: float, count: int = 1, *, height_ratios: Sequence[float] | None = None
) -> tuple[Figure, list[Axes]]:
    """A wide figure with axes below each other that share their time; in all of them time begins and ends
    at the same place, so that they can be read across. The legend's room is below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDE_IN, height_in))
    axes = figure.subplots(count, 1, sharex=True, squeeze=False, height_ratios=height_ratios)[:, 0].tolist()
    figure.subplots_adjust(
        left=0.115, right=0.985, top=1 - 0.12 / height_in, bottom=0.82 / height_in, hspace=0.12
    )
    return figure, axes


def legend_below(figure: Figure, handles: Sequence[Artist]) -> None:
    """One row of what the lines and shades mean."""
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=9)


def open_frame(*axes: Axes) -> None:
    """Leave the upper and the right line of the frame out."""
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)


def without_ticks(*axes: Axes) -> None:
    """Images need no ticks."""
    for axis in axes:
        axis.set(xticks=[], yticks=[])
