"""Dwell detection: where a stylus was held still on a landmark, or pivoted in its divot."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.calibration.inliers import MEDIAN_LENGTH, InlierRule, fit_inliers
from dvf_ig.core import (
    BoolArray,
    FloatArray,
    IntArray,
    InvalidInputError,
    Points,
    PoseStream,
    QualityGateError,
    read_only_arrays,
)

KEEP_SIGMA = 3.0
"""Samples within this many robust standard deviations of their dwell's pivot take part in `check_tip`."""


TipShift = tuple[FloatArray, FloatArray]
"""(3,) shift of a tip, and (n,) distance of each sample from the pivot of its dwell."""


RADIUS_MM = 1.5
"""A tip that rests stays within this distance of its running mean (PLUS: 1.5 mm)."""
MIN_S = 1.5
"""Shortest time for which it does."""
MERGE_MM = 5.0
"""Dwells closer than this, one after the other, are one landmark."""
MEMBER_SIGMA = 2.5 * MEDIAN_LENGTH
"""Samples within this many robust standard deviations of a dwell's centre belong to it; 3.8 (2.5 median
distances) take in all of a wobble but not the approach."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Dwells:
    """Points on which a tip rested.

    Attributes:
        points: (n, 3) mean tip positions, in order of time.
        start_s, stop_s: (n,) when each dwell began and ended.
        samples: (n,) samples in each.
        spread_mm: (n,) root mean square distance of those samples from the point.
    """

    points: Points
    start_s: FloatArray
    stop_s: FloatArray
    samples: IntArray
    spread_mm: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TipCheck:
    """Whether a stylus pivoted about its stated tip.

    Attributes:
        shift_mm: (3,) from the stated tip to the point about which the stylus pivoted in all dwells, in the
            stylus's frame.
        spread_mm: root mean square distance of the tip from its dwells' centres, as stated.
        spread_after_mm: the same for the shifted tip.
    """

    shift_mm: FloatArray
    spread_mm: float
    spread_after_mm: float


def tip_positions(poses: PoseStream, tip: Points) -> tuple[FloatArray, Points]:
    """Compute times (n valid,) and positions of a tool tip in the stream's target frame.

    Args:
        poses: target_from_source of the tool; invalid samples are left out.
        tip: one point in the stream's source frame.
    """
    if tip.frame != poses.source or len(tip) != 1:
        raise InvalidInputError(
            f"the tip is {len(tip)} points in frame '{tip.frame}'; needed one point in '{poses.source}'"
        )
    usable = poses.valid
    moved = poses.rotations[usable] @ tip.xyz_mm[0] + poses.translations_mm[usable]
    return poses.t_s[usable], Points(poses.target, moved)


def find_dwells(t_s: FloatArray, tip: Points) -> Dwells:
    """Find the dwells of a tip, in order of time.

    A dwell's position is the mean, not the median, of its samples: while a stylus pivots in a divot an error
    of its tip moves the tip on an orbit, and the mean over the orbit is where that error cancels.

    Args:
        t_s: (n,) times; tip: (n, 3) positions in a frame in which the landmarks do not move.
    Raises:
        QualityGateError: the tip was never held still.
    """
    runs = _merged(_still_runs(t_s, tip.xyz_mm), tip.xyz_mm)
    if not runs:
        raise QualityGateError(
            f"the tip was never held still within {RADIUS_MM:g} mm for {MIN_S:g} s; hold it "
            "on each landmark for a few seconds"
        )
    members = [_samples(k, runs, tip.xyz_mm) for k in range(len(runs))]
    centers = np.array([tip.xyz_mm[run].mean(axis=0) for run in members])
    spread = [_spread(tip.xyz_mm[run] - c) for run, c in zip(members, centers, strict=True)]
    return Dwells(
        points=Points(tip.frame, centers),
        start_s=np.array([t_s[run[0]] for run in members]),
        stop_s=np.array([t_s[run[-1]] for run in members]),
        samples=np.array([len(run) for run in members], dtype=np.int64),
        spread_mm=np.array(spread),
    )


def check_tip(poses: PoseStream, tip: Points, dwells: Dwells) -> TipCheck:
    """Compare a stylus's stated tip with the point about which it pivoted in all dwells.

    Least squares on R_i (tip + shift) + t_i = c_k for the samples i of each dwell k: a pivot calibration with
    one pivot a dwell. Samples of the approach, further than KEEP_SIGMA from their pivot, are left out. If the
    stylus was hardly rotated, the smallest shift that explains the samples is taken.
    """
    parts = []
    for start, stop in zip(dwells.start_s, dwells.stop_s, strict=True):
        inside = poses.valid & (poses.t_s >= start) & (poses.t_s <= stop)
        rotations = poses.rotations[inside]
        parts.append((rotations, rotations @ tip.xyz_mm[0] + poses.translations_mm[inside]))
    ends = np.cumsum([len(placed) for _, placed in parts])

    def fit(keep: BoolArray, _: TipShift | None) -> TipShift:
        return _common_shift(parts, np.split(keep, ends[:-1]))

    rule = InlierRule(KEEP_SIGMA, scale_from_inliers=True)
    agreed = fit_inliers(fit, lambda fitted: [fitted[1]], np.ones(ends[-1], dtype=np.bool_), rule)
    keep = agreed.inliers
    shift, after = agreed.model or fit(keep, None)
    before = _common_shift(parts, np.split(keep, ends[:-1]), solve=False)[1]
    spreads = [float(np.sqrt((distance[keep] ** 2).mean())) for distance in (before, after)]
    return TipCheck(shift, spreads[0], spreads[1])


def _common_shift(
    parts: list[tuple[FloatArray, FloatArray]], keep: list[BoolArray], *, solve: bool = True
) -> TipShift:
    """Fit the shift of the tip (zero unless solved for) from the kept samples, and the distances of all."""
    # each pivot is eliminated by taking the kept samples of its dwell from their mean
    means = [(r[k].mean(axis=0), p[k].mean(axis=0)) for (r, p), k in zip(parts, keep, strict=True)]
    rotated = [r - mean for (r, _), (mean, _) in zip(parts, means, strict=True)]
    placed = [p - mean for (_, p), (_, mean) in zip(parts, means, strict=True)]
    shift = np.zeros(3)
    if solve:
        matrix = np.concatenate([r[k].reshape(-1, 3) for r, k in zip(rotated, keep, strict=True)])
        side = np.concatenate([p[k].ravel() for p, k in zip(placed, keep, strict=True)])
        shift = np.linalg.lstsq(matrix, -side, rcond=0.02)[0]
    distances = [np.linalg.norm(r @ shift + p, axis=1) for r, p in zip(rotated, placed, strict=True)]
    return shift, np.concatenate(distances)


def _spread(offsets_mm: FloatArray) -> float:
    return float(np.sqrt((offsets_mm**2).sum(axis=1).mean()))


def _still_runs(t_s: FloatArray, xyz_mm: FloatArray) -> list[IntArray]:
    """Maximal runs of samples that stay within the radius of their own running mean."""
    runs: list[IntArray] = []
    start, total = 0, xyz_mm[0].copy()
    for i in range(1, len(xyz_mm) + 1):
        stays = i < len(xyz_mm) and float(np.linalg.norm(xyz_mm[i] - total / (i - start))) <= RADIUS_MM
        if stays:
            total += xyz_mm[i]
            continue
        if t_s[i - 1] - t_s[start] >= MIN_S:
            runs.append(np.arange(start, i))
        if i < len(xyz_mm):
            start, total = i, xyz_mm[i].copy()
    return runs


def _merged(runs: list[IntArray], xyz_mm: FloatArray) -> list[IntArray]:
    out: list[IntArray] = []
    for run in runs:
        center = np.median(xyz_mm[run], axis=0)
        if out and np.linalg.norm(center - np.median(xyz_mm[out[-1]], axis=0)) <= MERGE_MM:
            out[-1] = np.concatenate([out[-1], run])
        else:
            out.append(run)
    return out


def _samples(k: int, runs: list[IntArray], xyz_mm: FloatArray) -> IntArray:
    """Samples of dwell k, between its neighbours: the inliers about their own mean.

    A run depends on where its running mean began; this set does not.
    """
    first = runs[k - 1][-1] + 1 if k else 0
    stop = runs[k + 1][0] if k + 1 < len(runs) else len(xyz_mm)
    candidates = np.arange(first, stop)
    consensus = fit_inliers(
        lambda keep, _: xyz_mm[candidates[keep]].mean(axis=0),
        lambda center: [np.linalg.norm(xyz_mm[candidates] - center, axis=1)],
        np.isin(candidates, runs[k]),
        InlierRule(MEMBER_SIGMA, scale_from_inliers=True),
    )
    return candidates[consensus.inliers]
