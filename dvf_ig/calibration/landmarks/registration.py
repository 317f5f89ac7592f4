"""Landmark registration: a rigid map between paired points, with its evidence."""

from dataclasses import dataclass, replace
from itertools import combinations, permutations
from math import comb

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist, pdist

from dvf_ig.calibration.refusal import Gate, Refusal
from dvf_ig.core import FloatArray, InvalidInputError, Points, Rigid, read_only_arrays, require_same_frame
from dvf_ig.core.space.paired import fit_paired_points

from .dwells import Dwells

MOST_TRIPLES = 400
"""Triples of landmarks tried as images of the base triple, those of the most similar side lengths first."""


def second_pairing_rms_mm(target: Points, source: Points) -> float:
    """Compute the smallest RMS residual over pairings of the two sets other than the given one, mm.

    A value near the noise shows that the landmarks are almost symmetric: touched in another order they would
    fit as well, and nothing would show that the map is wrong.

    Args:
        target, source: (n, 3) mm each, in the same order; n >= 3, not on one line.
    """
    base = _widest_triple(source.xyz_mm)
    best = np.inf
    for images in _likely_images(target.xyz_mm, source.xyz_mm[list(base)]):
        try:
            guess = fit_paired_points(
                Points(target.frame, target.xyz_mm[list(images)]),
                Points(source.frame, source.xyz_mm[list(base)]),
            )
        except InvalidInputError:  # the three lie on one line, as the base triple does not
            continue
        order = _nearest_order(guess, target, source)
        if (order == np.arange(len(source))).all():
            continue
        best = min(best, _rms(target.xyz_mm[order], source, target.frame))
    return float(best)


def _widest_triple(xyz_mm: FloatArray) -> tuple[int, ...]:
    """Choose the three points that span the largest triangle."""
    triples = np.array(list(combinations(range(len(xyz_mm)), 3)))
    a, b, c = (xyz_mm[triples[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return tuple(triples[int(area.argmax())].tolist())


def _likely_images(target_mm: FloatArray, base_mm: FloatArray) -> list[tuple[int, ...]]:
    triples = list(permutations(range(len(target_mm)), 3))
    sides = np.array([pdist(target_mm[list(triple)]) for triple in triples])
    differences = np.abs(sides - pdist(base_mm)).sum(axis=1)
    return [triples[i] for i in np.argsort(differences, kind="stable")[:MOST_TRIPLES]]


def _nearest_order(guess: Rigid, target: Points, source: Points) -> FloatArray:
    """(n,) target index of each source point, by assignment and refit in alternation, as in ICP."""
    fitted, order = guess, np.full(len(source), -1)
    for _ in range(10):
        costs = cdist(fitted.apply_array(source.xyz_mm), target.xyz_mm) ** 2
        again = linear_sum_assignment(costs)[1]
        if np.array_equal(again, order):
            break
        order = again
        fitted = fit_paired_points(Points(target.frame, target.xyz_mm[order]), source)
    return order


def _rms(target_mm: FloatArray, source: Points, frame: str) -> float:
    fitted = fit_paired_points(Points(frame, target_mm), source)
    return float(np.sqrt(((fitted.apply_array(source.xyz_mm) - target_mm) ** 2).sum(axis=1).mean()))


MAX_CHOICES = 20_000
"""Most assignments of dwells to landmarks that are tried."""

AMBIGUOUS_RATIO, AMBIGUOUS_MM = 3.0, 1.0
"""Landmarks are ambiguous if the RMS of another pairing is within this factor of theirs, or below this."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkResult:
    """A rigid map with the evidence of its landmarks.

    Attributes:
        target_from_source: the map.
        residuals_mm: (n,) distance of each landmark after mapping.
        rms_mm, mean_mm: their root mean square and mean.
        leave_one_out_mm: (n,) error of each landmark under the map fitted without it (NaN for n = 3).
        second_rms_mm: smallest RMS residual of any other pairing of the same points.
        refusals: the gates that the map failed; it must not be used unless there are none.
    """

    target_from_source: Rigid
    residuals_mm: FloatArray
    rms_mm: float
    mean_mm: float
    leave_one_out_mm: FloatArray
    second_rms_mm: float
    refusals: tuple[Refusal, ...] = ()

    @property
    def ambiguous(self) -> bool:
        """True if landmarks touched in another order would have fitted about as well."""
        return self.second_rms_mm <= max(AMBIGUOUS_RATIO * self.rms_mm, AMBIGUOUS_MM)


@dataclass(frozen=True, slots=True)
class MapDifference:
    """Difference of two maps: their angle, and the distances between images of the same landmarks.

    Attributes:
        rotation_deg: angle between the two rotations.
        centroid_mm: distance between the two images of the landmarks' centroid.
        largest_mm: largest distance between the two images of a landmark.
    """

    rotation_deg: float
    centroid_mm: float
    largest_mm: float


def register_landmarks(target: Points, source: Points) -> LandmarkResult:
    """Fit target_from_source to paired landmarks by least squares, with residuals and leave-one-out errors.

    Raises:
        InvalidInputError: unequal counts, fewer than 3 pairs, or landmarks on one line.
    """
    fitted = fit_paired_points(target, source)
    residuals = np.linalg.norm(fitted.apply(source).xyz_mm - target.xyz_mm, axis=1)
    return LandmarkResult(
        target_from_source=fitted,
        residuals_mm=residuals,
        rms_mm=float(np.sqrt(np.mean(residuals**2))),
        mean_mm=float(residuals.mean()),
        leave_one_out_mm=_leave_one_out(target, source),
        second_rms_mm=second_pairing_rms_mm(target, source),
    )


def map_difference(first: Rigid, second: Rigid, landmarks: Points) -> MapDifference:
    """Compute how far two maps between the same frames differ, in rotation and at the landmarks.

    Args:
        first, second: target_from_source each.
        landmarks: (n, 3) in the source frame.
    """
    require_same_frame(first.target, second.target, "comparison of maps")
    gaps = first.apply(landmarks).xyz_mm - second.apply(landmarks).xyz_mm
    return MapDifference(
        rotation_deg=float(np.degrees((first.inverse() @ second).angle_rad)),
        centroid_mm=float(np.linalg.norm(gaps.mean(axis=0))),
        largest_mm=float(np.linalg.norm(gaps, axis=1).max()),
    )


def match_dwells(dwells: Dwells, landmarks: Points) -> tuple[LandmarkResult, tuple[int, ...]]:
    """Register landmarks touched in their order, among dwells that may include others.

    Args:
        dwells: in order of time.
        landmarks: (n, 3) in the order in which they were touched.
    Returns:
        target_from_source with target = frame of the dwells, source = frame of the landmarks, and which dwell
        is which landmark: the choice with the smallest residual. The map is refused if another choice
        that moves it by more than 2 mm fits as well.
    Raises:
        InvalidInputError: fewer dwells than landmarks, an excessive number of choices, or landmarks on one
            line.
    """
    count, need = len(dwells.points), len(landmarks)
    if count < need or comb(count, need) > MAX_CHOICES:
        raise InvalidInputError(
            f"the tip was held still in {count} places for {need} landmarks; needed {need} or a few more: "
            "touch each landmark once, in order, and hold still"
        )
    tried = []
    for choice in combinations(range(count), need):
        touched = Points(dwells.points.frame, dwells.points.xyz_mm[list(choice)])
        fitted = fit_paired_points(touched, landmarks)
        residuals = fitted.apply(landmarks).xyz_mm - touched.xyz_mm
        tried.append((float(np.sqrt((residuals**2).sum(axis=1).mean())), choice, fitted))
    tried.sort(key=lambda t: (t[0], t[1]))
    best = tried[0][1]
    touched = Points(dwells.points.frame, dwells.points.xyz_mm[list(best)])
    result = register_landmarks(touched, landmarks)
    return replace(result, refusals=_second_choice(tried, landmarks)), best


def _second_choice(
    tried: list[tuple[float, tuple[int, ...], Rigid]], landmarks: Points
) -> tuple[Refusal, ...]:
    """Refuse if a choice other than the best fits as well and gives another map."""
    rms, _, chosen = tried[0]
    for other_rms, _, other in tried[1:]:
        moved = chosen.apply(landmarks).xyz_mm - other.apply(landmarks).xyz_mm
        if other_rms <= max(1.5 * rms, rms + 0.2) and np.linalg.norm(moved, axis=1).max() > 2.0:
            detail = (
                f"two assignments of dwells to landmarks fit equally well ({rms:.2f} and {other_rms:.2f} mm "
                "RMS); touch each landmark once and hold still nowhere else"
            )
            return (Refusal(Gate.SECOND_ANSWER, detail),)
    return ()


def _leave_one_out(target: Points, source: Points) -> FloatArray:
    n = len(target)
    if n < 4:
        return np.full(n, np.nan)
    errors = np.empty(n)
    for i in range(n):
        others = np.delete(np.arange(n), i)
        try:
            fitted = fit_paired_points(
                Points(target.frame, target.xyz_mm[others]), Points(source.frame, source.xyz_mm[others])
            )
        except InvalidInputError:
            errors[i] = np.nan  # the other landmarks lie on one line
            continue
        errors[i] = np.linalg.norm(fitted.apply_array(source.xyz_mm[i]) - target.xyz_mm[i])
    return errors
