"""How the wires of a phantom are to be looked for in ultrasound images."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class WireSearch:
    """Settings of a search; None where nothing was said.

    Attributes:
        spacing_mm: pixel size.
        clip: first column, first row, columns, rows in px of the part of the image to search.
        candidates: largest number of bright dots that are considered.
        collinear_mm: largest distance of a dot from the line of its N pattern.
    """

    spacing_mm: float | None = None
    clip: tuple[int, int, int, int] | None = None
    candidates: int | None = None
    collinear_mm: float | None = None
