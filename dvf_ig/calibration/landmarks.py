"""Landmark registration: a rigid map between paired points, and finding the points in a stylus stream."""

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Points, PoseStream, QualityGateError, Rigid
from dvf_ig.core.paired import fit_paired_points

MAX_CHOICES = 20_000
"""Most assignments of rests to landmarks that are tried."""


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkResult:
    """A rigid map with the evidence of its landmarks.

    Attributes:
        target_from_source: the map.
        residuals_mm: (n,) distance of each landmark after mapping.
        rms_mm: their root mean square.
        leave_one_out_mm: (n,) error of each landmark under the map fitted without it (NaN for n = 3).
    """

    target_from_source: Rigid
    residuals_mm: FloatArray
    rms_mm: float
    leave_one_out_mm: FloatArray


@dataclass(frozen=True, slots=True)
class DwellOptions:
    """When a stylus counts as resting on a landmark.

    Attributes:
        radius_mm: the tip stays within this distance of its running mean.
        min_s: for at least this long.
        merge_mm: dwells closer than this, one after the other, are one landmark.
    """

    radius_mm: float = 1.5
    min_s: float = 1.5
    merge_mm: float = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Dwells:
    """Places where a tip rested.

    Attributes:
        points: (n, 3) median tip positions, in order of time.
        start_s, stop_s: (n,) when each rest began and ended.
        samples: (n,) samples in each.
        spread_mm: (n,) root mean square distance of those samples from the point.
    """

    points: Points
    start_s: FloatArray
    stop_s: FloatArray
    samples: np.ndarray[tuple[int], np.dtype[np.int64]]
    spread_mm: FloatArray


def register_landmarks(target: Points, source: Points) -> LandmarkResult:
    """target_from_source of paired landmarks by least squares, with residuals and leave-one-out errors.

    Raises:
        InvalidInputError: unequal counts, fewer than 3 pairs, or landmarks on one line.
    """
    fitted = fit_paired_points(target, source)
    residuals = np.linalg.norm(fitted.apply(source).xyz_mm - target.xyz_mm, axis=1)
    return LandmarkResult(
        target_from_source=fitted,
        residuals_mm=residuals,
        rms_mm=float(np.sqrt(np.mean(residuals**2))),
        leave_one_out_mm=_leave_one_out(target, source),
    )


def tip_positions(poses: PoseStream, tip: Points) -> tuple[FloatArray, Points]:
    """Times (n valid,) and positions of a tool tip in the stream's target frame.

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


def find_dwells(t_s: FloatArray, tip: Points, *, options: DwellOptions | None = None) -> Dwells:
    """Where a tip rested, one after the other.

    Args:
        t_s: (n,) times; tip: (n, 3) positions in a frame in which the landmarks stand still.
        options: see DwellOptions.
    Raises:
        QualityGateError: the tip never rested.
    """
    options = options or DwellOptions()
    runs = _merged(_still_runs(t_s, tip.xyz_mm, options), tip.xyz_mm, options)
    if not runs:
        raise QualityGateError(
            f"the tip never rested within {options.radius_mm:g} mm for {options.min_s:g} s; hold it on each "
            "landmark for a few seconds"
        )
    centers = np.array([np.median(tip.xyz_mm[run], axis=0) for run in runs])
    spread = [
        float(np.sqrt(((tip.xyz_mm[run] - c) ** 2).sum(axis=1).mean()))
        for run, c in zip(runs, centers, strict=True)
    ]
    return Dwells(
        points=Points(tip.frame, centers),
        start_s=np.array([t_s[run[0]] for run in runs]),
        stop_s=np.array([t_s[run[-1]] for run in runs]),
        samples=np.array([len(run) for run in runs], dtype=np.int64),
        spread_mm=np.array(spread),
    )


def match_dwells(dwells: Dwells, landmarks: Points) -> tuple[LandmarkResult, tuple[int, ...]]:
    """Landmarks touched in their order, among rests that may include others (before, between, after).

    Args:
        dwells: rests in order of time.
        landmarks: (n, 3) in the order in which they were touched.
    Returns:
        target_from_source with target = frame of the rests, source = frame of the landmarks, and which rest
        is which landmark: the choice with the smallest residual.
    Raises:
        InvalidInputError: fewer rests than landmarks, too many to try, or landmarks on one line.
        QualityGateError: another choice, that moves the map by more than 2 mm, fits as well.
    """
    count, need = len(dwells.points), len(landmarks)
    if count < need or comb(count, need) > MAX_CHOICES:
        raise InvalidInputError(
            f"the tip rested in {count} places for {need} landmarks; needed {need} or a few more: touch "
            "each landmark once, in order, and hold still"
        )
    tried = []
    for choice in combinations(range(count), need):
        rests = Points(dwells.points.frame, dwells.points.xyz_mm[list(choice)])
        fitted = fit_paired_points(rests, landmarks)
        misses = fitted.apply(landmarks).xyz_mm - rests.xyz_mm
        tried.append((float(np.sqrt((misses**2).sum(axis=1).mean())), choice, fitted))
    tried.sort(key=lambda t: (t[0], t[1]))
    rms, best, chosen = tried[0]
    for other_rms, _, other in tried[1:]:
        moved = chosen.apply(landmarks).xyz_mm - other.apply(landmarks).xyz_mm
        if other_rms <= max(1.5 * rms, rms + 0.2) and np.linalg.norm(moved, axis=1).max() > 2.0:
            raise QualityGateError(
                f"two assignments of rests to landmarks fit equally well ({rms:.2f} and {other_rms:.2f} mm "
                "RMS); touch each landmark once and rest nowhere else"
            )
    rests = Points(dwells.points.frame, dwells.points.xyz_mm[list(best)])
    return register_landmarks(rests, landmarks), best


Run = np.ndarray[tuple[int], np.dtype[np.intp]]


def _still_runs(t_s: FloatArray, xyz_mm: FloatArray, options: DwellOptions) -> list[Run]:
    """Maximal stretches that stay within the radius of their own running mean."""
    runs: list[Run] = []
    start, total = 0, xyz_mm[0].copy()
    for i in range(1, len(xyz_mm) + 1):
        stays = (
            i < len(xyz_mm) and float(np.linalg.norm(xyz_mm[i] - total / (i - start))) <= options.radius_mm
        )
        if stays:
            total += xyz_mm[i]
            continue
        if t_s[i - 1] - t_s[start] >= options.min_s:
            runs.append(np.arange(start, i))
        if i < len(xyz_mm):
            start, total = i, xyz_mm[i].copy()
    return runs


def _merged(runs: list[Run], xyz_mm: FloatArray, options: DwellOptions) -> list[Run]:
    out: list[Run] = []
    for run in runs:
        center = np.median(xyz_mm[run], axis=0)
        if out and np.linalg.norm(center - np.median(xyz_mm[out[-1]], axis=0)) <= options.merge_mm:
            out[-1] = np.concatenate([out[-1], run])
        else:
            out.append(run)
    return out


def _leave_one_out(target: Points, source: Points) -> FloatArray:
    n = len(target)
    if n < 4:
        return np.full(n, np.nan)
    errors = np.empty(n)
    for i in range(n):
        rest = np.delete(np.arange(n), i)
        try:
            fitted = fit_paired_points(
                Points(target.frame, target.xyz_mm[rest]), Points(source.frame, source.xyz_mm[rest])
            )
        except InvalidInputError:
            errors[i] = np.nan  # the other landmarks lie on one line
            continue
        errors[i] = np.linalg.norm(fitted.apply_array(source.xyz_mm[i]) - target.xyz_mm[i])
    return errors
