"""Whether two sets of landmarks are the same points in the same unit, with each name on the same point."""

from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from dvf_ig.core import FloatArray, IntArray, Landmarks

FEWEST = 4
"""Any exchange of three names may fit as well as their true order."""
ALL_ORDERS = 6
"""Up to this number of landmarks every order of the names is tried, else exchanges of two and three."""
UNEXPLAINED_MM = 5.0
"""RMS residual that needs no explanation: landmarks touched on a beating heart leave 1 to 4 mm."""
FALLS_TO = 0.4
"""Exchanged names explain a residual that falls below this share, and below UNEXPLAINED_MM."""
UNITS = {"m": 1000.0, "cm": 10.0, "inches": 25.4}
UNIT_TOLERANCE = 0.15
SMALLEST_MM = 1.0
"""Landmarks of an organ that lie within less of each other are in m."""


@dataclass(frozen=True, slots=True)
class ExchangedNames:
    """Names that are on each other's points, and the RMS residual of a rigid fit as given and put back."""

    names: tuple[str, ...]
    given_mm: float
    exchanged_mm: float

    @property
    def listed(self) -> str:
        """The names in a sentence."""
        return f"{', '.join(self.names[:-1])} and {self.names[-1]}"


def unit_of(points_mm: FloatArray, others_mm: FloatArray) -> str | None:
    """Name the unit, if not mm, of (n, 3) points by the extent of the same points on the other side."""
    extent, other = _extent_mm(points_mm), _extent_mm(others_mm)
    if 0.0 < extent < SMALLEST_MM:
        return "m"
    for name, factor in UNITS.items():
        if extent > 0.0 and abs(other / (factor * extent) - 1.0) < UNIT_TOLERANCE:
            return name
    return None


def exchanged_names(first: Landmarks, second: Landmarks) -> ExchangedNames | None:
    """Find names whose exchange makes the two sets fit each other far better; None if none does."""
    names, here, there = first.paired_with(second)
    if len(names) < FEWEST:
        return None
    orders = _orders(len(names))
    residuals = rigid_rms_mm(here.xyz_mm, there.xyz_mm[orders])
    best = int(np.argmin(residuals))
    given_mm, best_mm = float(residuals[0]), float(residuals[best])
    if given_mm < UNEXPLAINED_MM or best_mm > min(UNEXPLAINED_MM, FALLS_TO * given_mm):
        return None
    moved = tuple(name for i, name in enumerate(names) if orders[best, i] != i)
    return ExchangedNames(moved, given_mm, best_mm)


def rigid_rms_mm(target_mm: FloatArray, source_mm: FloatArray) -> FloatArray:
    """(...) RMS residuals of the best rigid fits of (..., n, 3) points to (n, 3) ones (Arun 1987)."""
    target = target_mm - target_mm.mean(axis=0)
    source = source_mm - source_mm.mean(axis=-2, keepdims=True)
    u, stretch, v = np.linalg.svd(np.swapaxes(source, -1, -2) @ target)
    stretch[..., 2] *= np.sign(np.linalg.det(u) * np.linalg.det(v))
    squares = (target**2).sum() + (source**2).sum(axis=(-1, -2)) - 2.0 * stretch.sum(axis=-1)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / len(target)))


def _orders(count: int) -> IntArray:
    """(k, count) orders to try, the given one first."""
    if count <= ALL_ORDERS:
        return np.array(list(permutations(range(count))))
    as_given = np.arange(count)
    orders = [as_given]
    for size in (2, 3):
        for chosen in combinations(range(count), size):
            for shift in range(1, size):
                order = as_given.copy()
                order[list(chosen)] = np.roll(chosen, shift)
                orders.append(order)
    return np.array(orders)


def _extent_mm(xyz_mm: FloatArray) -> float:
    """Root of the mean squared distance from the middle, which no rigid motion changes."""
    return float(np.sqrt(((xyz_mm - xyz_mm.mean(axis=0)) ** 2).sum(axis=1).mean()))
