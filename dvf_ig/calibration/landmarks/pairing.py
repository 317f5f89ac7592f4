"""Fit of landmarks paired in another order: would touching them in a wrong order be noticed."""

from itertools import combinations, permutations

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist, pdist

from dvf_ig.core import FloatArray, InvalidInputError, Points, Rigid
from dvf_ig.core.space.paired import fit_paired_points

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
