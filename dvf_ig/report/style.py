"""Common style of the figures: colours by meaning, and output as PNG, JPEG and SVG.

Blue is an estimate or a used item, orange the start, a rival or an excluded item, black the truth or the
reference. The modules that draw load matplotlib, not this one.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.io.provenance import MARK
from dvf_ig.io.writing.atomic import write_bytes

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ESTIMATE, START, TRUTH = "#1f6fb4", "#e07b00", "#222222"
WRONG = "#c43131"
"""Colour of refused items and of equations as misprinted."""
FAINT, GUIDE = "#b8b8b8", "#8a8a8a"
"""Colours of comparison data in the background, and of guide lines."""
REFUSED, SUSPENDED = "#d9d9d9", "#f6d5d2"
"""Shades of times without force, and of times with a suspended pose."""
ON_GREY = "#41b6e6"
"""Colour of outlines over grey images, on which blue is too dark."""
MR_ON_GREY = "#e69f00"
"""Colour of MR over grey ultrasound; safe with ON_GREY for colour-blind readers (Okabe and Ito 2008)."""
SERIES = (ESTIMATE, START, "#2a8c4a", "#8e44ad", "#7f6a55", WRONG)
"""Colours of series of equal rank, ours first."""
BLUES = ("#9ecae1", "#4a9bd0", "#1f6fb4", "#123f6e")
"""Colours of a growing parameter, pale to dark."""
LABELS_ON_GREY = (
    *("#c3a1e0", "#77aadd", "#eedd88", "#99ddff", "#ffaabb", "#44bb99"),
    *("#bbcc33", "#ff7fd0", "#aaaa00", "#dddddd", "#b08968", "#5b8c5a"),
)
"""Colours of tissue labels over ultrasound."""
DPI = 110
WIDE_IN = 10.5
"""Width of a figure that spans a page, inches."""


def label_color(value: int) -> str:
    """Return the colour of a tissue label over ultrasound."""
    return LABELS_ON_GREY[(value - 1) % len(LABELS_ON_GREY)]


def png_bytes(figure: Figure, dpi: int = DPI) -> bytes:
    """Encode a figure as PNG; the same figure gives the same bytes."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": MARK})
    return buffer.getvalue()


def jpeg_bytes(figure: Figure) -> bytes:
    """Encode a figure as JPEG: a fifth of a PNG's size for speckle."""
    buffer = BytesIO()
    figure.savefig(buffer, format="jpeg", dpi=DPI, pil_kwargs={"quality": 88, "subsampling": 0})
    return buffer.getvalue()


def svg_bytes(figure: Figure) -> bytes:
    """Encode a figure as SVG; the same figure gives the same bytes."""
    from matplotlib import rc_context

    buffer = BytesIO()
    with rc_context({"svg.hashsalt": "dvf_ig"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def png_path(path: Path | str) -> Path:
    """Return the path if it ends in .png.

    Raises:
        InvalidInputError: another suffix.
    """
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InvalidInputError(f"{path} does not end in .png; pictures are written as PNG")
    return path


def write_png(path: Path | str, figure: Figure, dpi: int = DPI) -> None:
    """Write the figure as a whole or not at all.

    Raises:
        InvalidInputError: a suffix that is not .png.
        OutputError: not writable.
    """
    write_bytes(png_path(path), png_bytes(figure, dpi))


def time_axes(
    height_in: float, count: int = 1, *, height_ratios: Sequence[float] | None = None
) -> tuple[Figure, list[Axes]]:
    """Build a wide figure of stacked axes with a common time axis, aligned so that they can be read across,
    and with room for a legend below.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDE_IN, height_in))
    axes = figure.subplots(count, 1, sharex=True, squeeze=False, height_ratios=height_ratios)[:, 0].tolist()
    figure.subplots_adjust(
        left=0.115, right=0.985, top=1 - 0.12 / height_in, bottom=0.82 / height_in, hspace=0.12
    )
    return figure, axes


def legend_below(figure: Figure, handles: Sequence[Artist]) -> None:
    """Draw one row of legend entries below the axes."""
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=9)


def open_frame(*axes: Axes) -> None:
    """Hide the upper and the right line of the frame."""
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)


def without_ticks(*axes: Axes) -> None:
    """Remove the ticks, which images do not need."""
    for axis in axes:
        axis.set(xticks=[], yticks=[])
