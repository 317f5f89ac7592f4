"""Lines of three dots, and sets of them that match the patterns of an N-wire phantom."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, read_only_arrays

from .plan import Labelling, WirePlan


@dataclass(frozen=True, slots=True)
class LineOptions:
    """Tolerances for dots on one line and for lines that belong together.

    Attributes:
        scale_share: pixel sizes may differ from the approximate one by this share.
        max_tilt_deg: largest angle between the image and the plane across the wires.
        max_turn_deg: largest angle between a line of three dots and the image's rows.
        collinear_mm: a diagonal's dot lies within this distance of the line of its pattern.
        place_mm: a line lies within this distance, and a tenth of the distance from the first line, of the
            place that the first line predicts.
        end_mm: a diagonal may be met this far beyond its ends.
    """

    scale_share: float = 0.15
    max_tilt_deg: float = 35.0
    max_turn_deg: float = 70.0
    collinear_mm: float = 1.0
    place_mm: float = 1.5
    end_mm: float = 2.0


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
    xy_mm: FloatArray, plan: WirePlan, pattern: int, labelling: Labelling, options: LineOptions
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
    longest = width * (1 + options.scale_share) / np.cos(np.radians(options.max_tilt_deg))
    fits = (length >= width * (1 - options.scale_share)) & (length <= longest)
    angle = np.arctan2(step[..., 1], forward * step[..., 0])
    ends = np.argwhere(fits & (np.abs(angle) <= np.radians(options.max_turn_deg)))
    unit = (step / np.where(length > 0, length, 1.0)[..., None])[ends[:, 0], ends[:, 1]]
    offset = xy_mm[None] - xy_mm[ends[:, 0], None]
    beside = np.abs(offset[..., 1] * unit[:, None, 0] - offset[..., 0] * unit[:, None, 1])
    share = np.einsum("mnk,mk->mn", offset, unit) / length[ends[:, 0], ends[:, 1], None]
    low, high = np.sort((plan.across_mm[pattern] - first[0]) / (last[0] - first[0]))
    margin = options.end_mm / width
    between = (beside <= options.collinear_mm) & (share >= low - margin) & (share <= high + margin)
    np.put_along_axis(between, ends, False, axis=1)
    crossed = between.any(axis=1)
    return Lines(ends[crossed], between[crossed])


def line_sets(
    xy_mm: FloatArray, plan: WirePlan, lines: list[Lines], labelling: Labelling, options: LineOptions
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
        near.append(offset <= options.place_mm + 0.1 * np.abs(plane[k] - plane[0].mean()).max())
    for i in range(len(lines[0])):
        for others in product(*(np.flatnonzero(n[i]).tolist() for n in near)):
            chosen = list(zip(lines, (i, *others), strict=True))
            ends = np.stack([line.ends[j] for line, j in chosen])
            if len(np.unique(ends)) == ends.size:
                yield LineSet(ends, np.stack([line.between[j] for line, j in chosen]))
