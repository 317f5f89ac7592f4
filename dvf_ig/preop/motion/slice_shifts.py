"""Shifts of slices that were each acquired in another breath-hold, by consistency where they intersect.

Slice k shows the heart displaced by s_k: a point q of the heart lies at q + s_k in it. Where a short-axis
slice and a long-axis view intersect both show the same points of the heart, so that along that line

    z(I_k(q + s_k)) = z(I_v(q + s_v)),    q on the planes of both, moved by −s_k and −s_v

at every phase, z(·) a profile of zero mean and unit variance. In addition the left ventricle's middle bends
little from slice to slice, and no shift is large. All are least squares over every s, by Gauss–Newton with
differences; the mean over all slices is nobody's shift and is taken out. Without long-axis views only the
labels' middle is left, and only within the slices' planes.

Source: Villard et al. 2017, and Sinclair et al. 2017, on correction of breath-hold shifts by intersections.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dvf_ig.core import BoolArray, FloatArray, Grid, VolumeSeries, nearest_phase, read_only_arrays

PRIOR_MM = 2.0
"""Standard deviation of a shift per coordinate: end-expiration varies by some mm."""
BEND_MM = 2.0
"""Standard deviation of the second difference of the left ventricle's middle from slice to slice."""
PHASES = 6
"""Phases of the cycle at which profiles are compared."""
STEP_MM = 1.5
"""Step along a profile; REACH_MM: how far profiles reach beyond the organ."""
REACH_MM = 10.0
LEAST_POINTS = 12
"""Points of a profile; shorter ones are left out."""
NOISE, CORRELATED_POINTS = 0.4, 4.0
"""Least standard deviation of a matched pair's difference, and how many neighbouring points count as one."""
ROUNDS, DIFFERENCE_MM, LONGEST_MM = 12, 0.5, 1.5
"""Rounds of Gauss–Newton, step of its differences, and the longest step of a coordinate."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SliceShifts:
    """Displacement of the heart in every slice.

    Attributes:
        sax_mm: (k, 3) of each slice of the stack; views_mm: (v, 3) of each long-axis view.
        sax_sigma_mm: (k, 3) standard deviation per coordinate along rows, columns and normal of the stack.
        before, after: mean correlation of profiles along the intersections; NaN without long-axis views.
        normal: (3,) of the stack; heights_mm: (k,) of its slices along it.
    """

    sax_mm: FloatArray
    views_mm: FloatArray
    sax_sigma_mm: FloatArray
    before: float
    after: float
    normal: FloatArray
    heights_mm: FloatArray

    def corrected(self, xyz_mm: FloatArray) -> FloatArray:
        """(..., 3) points as the stack shows them, moved to where the heart is on the mean of all slices."""
        along = xyz_mm @ self.normal
        shift = [np.interp(along, self.heights_mm, self.sax_mm[:, axis]) for axis in range(3)]
        return np.asarray(xyz_mm - np.stack(shift, axis=-1))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Slice:
    """One slice through the cycle."""

    grid: Grid
    values: FloatArray
    """(n, nx, ny)"""
    fractions: FloatArray

    @property
    def normal(self) -> FloatArray:
        return np.asarray(self.grid.direction[:, 2])

    def at(self, xyz_mm: FloatArray, fractions: FloatArray) -> FloatArray:
        """(..., phases, n) grey levels at (..., n, 3) points of its plane, NaN outside the image."""
        index = self.grid.to_index(xyz_mm)[..., None, :, :2]
        numbers = nearest_phase(self.fractions, fractions)[:, None].astype(np.float64)
        at = np.broadcast_arrays(numbers, index[..., 0], index[..., 1])
        return np.asarray(ndimage.map_coordinates(self.values, at, order=1, cval=np.nan))


def slice_shifts(
    image: VolumeSeries, organ: BoolArray, middle: BoolArray, views: Sequence[VolumeSeries]
) -> SliceShifts:
    """Estimate the shift of every slice of a stack, and of every long-axis view.

    Args:
        image: the stack, slices along its last axis.
        organ: (nx, ny, nz) voxels of the organ at end-diastole.
        middle: (nx, ny, nz) voxels of the left ventricle's cavity, or of the organ if none is labelled.
        views: one slice each.
    """
    slices = [_slice_of(image, k) for k in range(image.grid.shape[2])]
    planes = [_slice_of(view, 0) for view in views]
    everything = [*slices, *planes]
    count = len(slices)
    pairs = [(k, count + v) for k in range(count) for v in range(len(planes)) if organ[:, :, k].any()]
    low, high = _box_mm(image.grid, organ)
    shifts = np.zeros((len(everything), 3))
    bend, bend_value = _bending(image.grid, middle, len(everything))
    before = _mean_correlation(everything, pairs, shifts, (low, high))
    information = np.eye(shifts.size) / PRIOR_MM**2
    for _ in range(ROUNDS):
        information = np.eye(shifts.size) / PRIOR_MM**2 + bend.T @ bend
        pull = -shifts.ravel() / PRIOR_MM**2 - bend.T @ (bend @ shifts.ravel() - bend_value)
        for pair in pairs:
            residual, jacobian = _pair(everything, pair, shifts, (low, high))
            if residual is None or jacobian is None:
                continue
            noise = max(NOISE, float(residual.std()))
            weight = 1.0 / (noise**2 * CORRELATED_POINTS * PHASES / 2.0)
            where = np.concatenate([3 * pair[0] + np.arange(3), 3 * pair[1] + np.arange(3)])
            information[np.ix_(where, where)] += weight * jacobian.T @ jacobian
            pull[where] -= weight * jacobian.T @ residual
        step = np.clip(np.linalg.solve(information, pull), -LONGEST_MM, LONGEST_MM).reshape(-1, 3)
        shifts = shifts + step
        if float(np.abs(step).max()) < 0.02:
            break
    shifts = shifts - shifts.mean(axis=0)
    after = _mean_correlation(everything, pairs, shifts, (low, high))
    return SliceShifts(
        shifts[:count],
        shifts[count:],
        _sigmas_mm(np.asarray(np.linalg.inv(information)), image.grid.direction, count),
        before,
        after,
        image.grid.direction[:, 2],
        np.array([one.grid.origin_mm @ image.grid.direction[:, 2] for one in slices]),
    )


def _slice_of(series: VolumeSeries, k: int) -> _Slice:
    grid = series.grid
    origin = grid.to_mm(np.array([0.0, 0.0, float(k)]))
    own = Grid(grid.frame, (grid.shape[0], grid.shape[1], 1), origin, grid.spacing_mm, grid.direction)
    return _Slice(own, np.asarray(series.values[..., k], dtype=np.float64), series.timing.fractions)


def _box_mm(grid: Grid, organ: BoolArray) -> tuple[FloatArray, FloatArray]:
    points = grid.to_mm(np.argwhere(organ).astype(np.float64))
    return points.min(axis=0) - REACH_MM, points.max(axis=0) + REACH_MM


def _bending(grid: Grid, middle: BoolArray, count: int) -> tuple[FloatArray, FloatArray]:
    """(rows, 3 count) and (rows,) of the second differences of the middle, within the slices' planes."""
    slices = [k for k in range(grid.shape[2]) if middle[:, :, k].any()]
    at = {k: grid.to_mm(np.array([*np.argwhere(middle[:, :, k]).mean(axis=0), k])) for k in slices}
    rows, values = [], []
    for below, k, above in zip(slices, slices[1:], slices[2:], strict=False):
        for axis in (0, 1):
            direction = grid.direction[:, axis]
            row = np.zeros((count, 3))
            row[below] = row[above] = 0.5 * direction
            row[k] = -direction
            rows.append(row.ravel() / BEND_MM)
            values.append(float(direction @ (0.5 * (at[below] + at[above]) - at[k])) / BEND_MM)
    if not rows:
        return np.zeros((0, 3 * count)), np.zeros(0)
    return np.stack(rows), np.array(values)


def _pair(
    everything: Sequence[_Slice],
    pair: tuple[int, int],
    shifts: FloatArray,
    box_mm: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray | None, FloatArray | None]:
    """Differences of the profiles of an intersection and their derivatives by both shifts."""
    a, b = everything[pair[0]], everything[pair[1]]
    offsets = _line(a, b, shifts[list(pair)], box_mm)
    if offsets is None:
        return None, None
    moved = shifts[list(pair)] + np.concatenate([np.zeros((1, 6)), DIFFERENCE_MM * np.eye(6)]).reshape(
        7, 2, 3
    )
    profiles = _profiles(a, b, moved, offsets, box_mm)
    if profiles is None:
        return None, None
    differences = (profiles[0] - profiles[1]).reshape(7, -1)
    return differences[0], (differences[1:] - differences[0]).T / DIFFERENCE_MM


def _line(
    a: _Slice, b: _Slice, shifts: FloatArray, box_mm: tuple[FloatArray, FloatArray]
) -> FloatArray | None:
    """Positions along the intersection, from the point of it nearest the box's middle, within the box."""
    start, along = _intersection(a, b, shifts, box_mm)
    half = 0.5 * float(np.linalg.norm(box_mm[1] - box_mm[0]))
    offsets = np.arange(-half, half, STEP_MM)
    points = start + offsets[:, None] * along
    inside = ((points > box_mm[0]) & (points < box_mm[1])).all(axis=1)
    for one, shift in zip((a, b), shifts, strict=True):
        index = one.grid.to_index(points + shift)[:, :2]
        inside &= ((index > 3.0) & (index < np.array(one.grid.shape[:2]) - 4.0)).all(axis=1)
    return offsets[inside] if int(inside.sum()) >= LEAST_POINTS else None


def _intersection(
    a: _Slice, b: _Slice, shifts: FloatArray, box_mm: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """(..., 3) point and the direction of the line of the heart that both slices show.

    Args:
        shifts: (..., 2, 3) of both slices.
    """
    along = np.cross(a.normal, b.normal)
    along = along / np.linalg.norm(along)
    middle = 0.5 * (box_mm[0] + box_mm[1])
    heights = np.stack(
        [
            (a.grid.origin_mm - shifts[..., 0, :]) @ a.normal,
            (b.grid.origin_mm - shifts[..., 1, :]) @ b.normal,
            np.full(shifts.shape[:-2], along @ middle),
        ],
        axis=-1,
    )
    return heights @ np.linalg.inv(np.stack([a.normal, b.normal, along])).T, along


def _profiles(
    a: _Slice, b: _Slice, shifts: FloatArray, offsets: FloatArray, box_mm: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray] | None:
    """(..., PHASES, n) normalised profiles of both slices along their intersection.

    Args:
        shifts: (..., 2, 3) of both slices.
    """
    start, along = _intersection(a, b, shifts, box_mm)
    points = start[..., None, :] + offsets[:, None] * along
    fractions = np.arange(PHASES) / PHASES
    first, second = (
        ndimage.gaussian_filter1d(one.at(points + shifts[..., k, None, :], fractions), 1.0, axis=-1)
        for k, one in enumerate((a, b))
    )
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        return None
    return _normalised(first), _normalised(second)


def _normalised(profile: FloatArray) -> FloatArray:
    """Zero mean and unit variance over all phases together."""
    mean, deviation = (f(profile, axis=(-2, -1), keepdims=True) for f in (np.mean, np.std))
    return np.asarray((profile - mean) / np.maximum(deviation, 1e-9))


def _mean_correlation(
    everything: Sequence[_Slice],
    pairs: Sequence[tuple[int, int]],
    shifts: FloatArray,
    box_mm: tuple[FloatArray, FloatArray],
) -> float:
    found = []
    for pair in pairs:
        a, b = everything[pair[0]], everything[pair[1]]
        offsets = _line(a, b, shifts[list(pair)], box_mm)
        profiles = None if offsets is None else _profiles(a, b, shifts[list(pair)], offsets, box_mm)
        if profiles is not None:
            found.append(float((profiles[0] * profiles[1]).mean()))
    return float(np.mean(found)) if found else float("nan")


def _sigmas_mm(covariance: FloatArray, axes: FloatArray, count: int) -> FloatArray:
    blocks = [covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(count)]
    return np.array([np.sqrt(np.diag(axes.T @ block @ axes)) for block in blocks])
