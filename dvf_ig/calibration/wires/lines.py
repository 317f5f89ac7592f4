"""Lines of three dots, and sets of them that match the patterns of an N-wire phantom."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, read_only_arrays

from .plan import Labelling, WirePlan

MAX_TILT_DEG = 35.0
"""Largest angle between the image and the plane across the wires."""
MAX_TURN_DEG = 70.0
"""Largest angle between a line of three dots and the image's rows."""
PLACE_MM = 1.5
"""A line is within this distance, and a tenth of the distance from the first line, of where the first line
predicts it."""
END_MM = 2.0
"""A diagonal may be met this far beyond its ends."""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """How closely dots must match the phantom's wires.

    Attributes:
        collinear_mm: a diagonal's dot is within this distance of the line of its pattern.
        scale_share: pixel sizes may differ from the approximate one by this share.
    """

    collinear_mm: float = 1.0
    scale_share: float = 0.15


USUAL_TOLERANCES = Tolerances()


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Pairs of dots that may be the outer wires of one pattern.

    Attributes:
        ends: (m, 2) dots of the first and of the last wire.
        between: (m, n) True for the dots that may be the diagonal.
    """

    ends: IntArray
    between: BoolArray

    def __len__(self) -> int:
        return len(self.ends)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LineSet:
    """One line for each pattern.

    Attributes:
        ends: (patterns, 2) dots of the outer wires.
        between: (patterns, n) True for the dots that may be the diagonals.
    """

    ends: IntArray
    between: BoolArray


def find_lines(
    xy_mm: FloatArray, plan: WirePlan, pattern: int, labelling: Labelling, tolerances: Tolerances
) -> Lines:
    """Find pairs at the distance of a pattern's outer wires, as labelled, with a dot between them.

    Args:
        xy_mm: (n, 2) dots, columns and rows times the approximate pixel size.
    """
    first, last = plan.outer_mm[pattern]
    width = abs(last[0] - first[0])
    forward = -labelling[0] * np.sign(last[0] - first[0])
    step = xy_mm[None] - xy_mm[:, None]
    length = np.linalg.norm(step, axis=2)
    longest = width * (1 + tolerances.scale_share) / np.cos(np.radians(MAX_TILT_DEG))
    fits = (length >= width * (1 - tolerances.scale_share)) & (length <= longest)
    angle = np.arctan2(step[..., 1], forward * step[..., 0])
    ends = np.argwhere(fits & (np.abs(angle) <= np.radians(MAX_TURN_DEG)))
    unit = (step / np.where(length > 0, length, 1.0)[..., None])[ends[:, 0], ends[:, 1]]
    offset = xy_mm[None] - xy_mm[ends[:, 0], None]
    beside = np.abs(offset[..., 1] * unit[:, None, 0] - offset[..., 0] * unit[:, None, 1])
    share = np.einsum("mnk,mk->mn", offset, unit) / length[ends[:, 0], ends[:, 1], None]
    low, high = np.sort((plan.across_mm[pattern] - first[0]) / (last[0] - first[0]))
    margin = END_MM / width
    between = (beside <= tolerances.collinear_mm) & (share >= low - margin) & (share <= high + margin)
    np.put_along_axis(between, ends, False, axis=1)
    crossed = between.any(axis=1)
    return Lines(ends[crossed], between[crossed])


def line_sets(
    xy_mm: FloatArray, plan: WirePlan, lines: list[Lines], labelling: Labelling
) -> Iterator[LineSet]:
    """Find sets in which each line lies where the first one predicts it by a similarity of the plan.

    Args:
        lines: of each pattern, under this labelling.
    """
    spots = xy_mm[:, 0] + 1j * xy_mm[:, 1]
    plane = plan.outer_mm[..., 0] + 1j * plan.outer_mm[..., 1]
    # PLUS's images show the phantom mirrored: across runs left, down runs down
    if labelling[0] * labelling[1] > 0:
        plane = plane.conj()
    start, end = spots[lines[0].ends].T
    similarity = (end - start) / (plane[0, 1] - plane[0, 0])
    near = []
    for k in range(1, len(lines)):
        predicted = start[:, None] + similarity[:, None] * (plane[k] - plane[0, 0])
        offset = np.abs(predicted[:, None] - spots[lines[k].ends][None]).max(axis=2)
        near.append(offset <= PLACE_MM + 0.1 * np.abs(plane[k] - plane[0].mean()).max())
    for i in range(len(lines[0])):
        for others in product(*(np.flatnonzero(n[i]).tolist() for n in near)):
            chosen = list(zip(lines, (i, *others), strict=True))
            ends = np.stack([line.ends[j] for line, j in chosen])
            if len(np.unique(ends)) == ends.size:
                yield LineSet(ends, np.stack([line.between[j] for line, j in chosen]))
