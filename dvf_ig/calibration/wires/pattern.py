"""Assignment of an image's dots to the wires of an N-wire phantom, by geometry alone."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from dvf_ig.calibration.refusal import RejectedFrame, Rejection
from dvf_ig.core import FloatArray, IntArray, read_only_arrays

from .dots import Dots
from .lines import MAX_TILT_DEG, USUAL_TOLERANCES, Lines, LineSet, Tolerances, find_lines, line_sets
from .plan import Labelling, WirePlan

MIN_SPREAD_MM = 5.0
"""Diagonals' dots must spread this far in a direction (root sum of squares) to show the tilt along it."""

DOT_SD_MM = 0.3
"""Typical misplacement of a dot; misfit in these units is weighed against brightness."""
MAX_MISFIT_MM = 0.7
"""Largest root mean square misfit of the outer wires."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FoundWires:
    """Wires found in one frame.

    Attributes:
        points_px: (wires, 2) column, row in the phantom's order.
        misfit_mm: root mean square distance of the outer wires from the phantom's shape.
        scale: true over approximate pixel size, along the direction in the image that suffers no tilt.
        labelling: orientation of the plan in the image.
    """

    points_px: FloatArray
    misfit_mm: float
    scale: float
    labelling: Labelling


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Match:
    """Candidate assignment of dots to wires.

    Attributes:
        wires: (wires,) dots in the phantom's order.
        cost: squared misfit in units of the dot's SD, less twice the log of the dots' contrast.
        fault: why it cannot be the phantom, or None.
    """

    wires: IntArray
    misfit_mm: float
    scale: float
    labelling: Labelling
    cost: float
    fault: RejectedFrame | None


def find_wires(
    dots: Dots,
    plan: WirePlan,
    spacing_mm: float,
    tolerances: Tolerances = USUAL_TOLERANCES,
) -> FoundWires | RejectedFrame:
    """Find the dots that best match the phantom, or the reason why there are none.

    Pairs of dots at the distance of two outer wires, with a third between them, are lines. A line of the
    first pattern predicts where the others lie; among complete sets of lines, the one with the least
    misfit to the phantom and the brightest dots is taken. Which end is which follows from the outer wires;
    where these are symmetric, from PLUS's convention (first wire right, first pattern on top).

    Args:
        dots: candidates.
        plan: see `plan_wires`.
        spacing_mm: approximate pixel size.
        tolerances: of the dots.
    """
    xy_mm = dots.points_px * spacing_mm
    patterns = range(len(plan.outer_mm))
    tried = [
        (labelling, [find_lines(xy_mm, plan, k, labelling, tolerances) for k in patterns])
        for labelling in plan.labellings
    ]
    matches = [
        match
        for labelling, lines in tried
        for chosen in line_sets(xy_mm, plan, lines, labelling)
        for match in _matches(dots, xy_mm, plan, chosen, labelling, tolerances.scale_share)
    ]
    best = min(matches, key=lambda m: (m.fault is not None, m.cost), default=None)
    if best is None:
        return _rejected(len(dots), [lines for _, lines in tried])
    if best.fault is not None:
        return best.fault
    return FoundWires(dots.points_px[best.wires], best.misfit_mm, best.scale, best.labelling)


def _matches(
    dots: Dots,
    xy_mm: FloatArray,
    plan: WirePlan,
    chosen: LineSet,
    labelling: Labelling,
    scale_share: float,
) -> list[_Match]:
    """List the choices of diagonals on one set of lines."""
    ends = chosen.ends.ravel()
    shape = plan.outer_mm.reshape(-1, 2)
    with_one = np.column_stack([xy_mm, np.ones(len(xy_mm))])
    plan_from_image = np.linalg.lstsq(with_one[ends], shape, rcond=None)[0].T
    placed = with_one @ plan_from_image.T
    residuals = np.square(placed[ends] - shape).sum(axis=1)
    misfit = float(np.sqrt(residuals.mean()))
    large, small = np.linalg.svd(plan_from_image[:, :2])[1].tolist()
    fault = _shape_fault(misfit, large, small, scale_share)
    out = []
    for middle in product(*(np.flatnonzero(row).tolist() for row in chosen.between)):
        wires = np.column_stack([chosen.ends[:, 0], middle, chosen.ends[:, 1]]).ravel()
        at = placed[list(middle)]
        off_line = at[:, 1] - plan.outer_mm[:, :, 1].mean(axis=1)
        cost = (residuals.sum() + off_line @ off_line) / DOT_SD_MM**2
        cost -= 2.0 * np.log(dots.strength[wires]).sum()
        slope = _slope_fault(xy_mm[list(middle)], at[:, 0], plan, scale_share)
        out.append(_Match(wires, misfit, large, labelling, float(cost), fault or slope))
    return out


def _shape_fault(misfit_mm: float, large: float, small: float, scale_share: float) -> RejectedFrame | None:
    """Check the outer wires: their shape, and the tilt that follows from their foreshortening."""
    if misfit_mm > MAX_MISFIT_MM:
        return RejectedFrame(
            Rejection.MISFIT,
            f"outer wires miss the phantom's shape by {misfit_mm:.2f} mm, at most {MAX_MISFIT_MM:g}",
        )
    least, most = 1 - scale_share, 1 + scale_share
    if not least <= large <= most:
        return RejectedFrame(
            Rejection.MISFIT,
            f"the phantom appears {large:.2f} times its size, between {least:.2f} and {most:.2f} "
            "expected of this pixel size",
        )
    if small < least * np.cos(np.radians(MAX_TILT_DEG)):
        return _steep(float(np.degrees(np.arccos(min(1.0, small / large)))))
    return None


def _slope_fault(
    middle_mm: FloatArray, across_mm: FloatArray, plan: WirePlan, scale_share: float
) -> RejectedFrame | None:
    """Check the diagonals: the tilt that follows from the positions along the wires at which they are met.

    The image is a plane, so the position along the wires is linear over the image and its gradient is the
    sine of the tilt. Two diagonals, or three nearly in line, give a part of the gradient.
    """
    start, end = plan.across_mm.T
    share = (across_mm - start) / (end - start)
    along = plan.along_mm[:, 0] + share * (plan.along_mm[:, 1] - plan.along_mm[:, 0])
    into_axes, spread_mm, _ = np.linalg.svd(middle_mm - middle_mm.mean(axis=0), full_matrices=False)
    determined = spread_mm >= MIN_SPREAD_MM
    sine = float(np.linalg.norm((into_axes.T @ along)[determined] / spread_mm[determined]))
    if sine > np.sin(np.radians(MAX_TILT_DEG)) * (1 + scale_share):
        return _steep(float(np.degrees(np.arcsin(min(1.0, sine)))))
    return None


def _steep(tilt_deg: float) -> RejectedFrame:
    return RejectedFrame(
        Rejection.STEEP, f"the image lies {tilt_deg:.0f}° off across the wires, at most {MAX_TILT_DEG:g}°"
    )


def _rejected(dots: int, tried: list[list[Lines]]) -> RejectedFrame:
    """Explain why no set of lines was found, from the lines of each labelling and pattern."""
    patterns = len(tried[0])
    seen = max(_separate_lines(lines) for lines in tried)
    if dots < 3 * patterns:
        on_lines = f" on {_count(seen, 'line')}" if seen else ""
        return RejectedFrame(
            Rejection.TOO_FEW_DOTS, f"{3 * patterns} wires expected, {_count(dots, 'dot')} found{on_lines}"
        )
    if seen == 0:
        return RejectedFrame(Rejection.NO_LINE, f"no line of three dots among {dots}")
    if seen < patterns:
        return RejectedFrame(
            Rejection.LINES_APART, f"{patterns} lines expected, {dots} dots form {_count(seen, 'line')}"
        )
    return RejectedFrame(
        Rejection.LINES_APART, f"no {patterns} lines among {dots} dots lie at the phantom's distances"
    )


def _separate_lines(lines: list[Lines]) -> int:
    """Count lines that share no end, of any pattern."""
    used_ends: set[int] = set()
    count = 0
    for first, last in (pair for of_pattern in lines for pair in of_pattern.ends.tolist()):
        if first not in used_ends and last not in used_ends:
            used_ends |= {first, last}
            count += 1
    return count


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
