"""A line on the heart, or a point, that rides on the beating surface at a wanted depth."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from data_synth.operator.contact import MovingSurface
from data_synth.operator.contact_sites import Site
from dvf_ig.core import FloatArray, read_only_arrays

PHASES = 128
STEP_MM = 1.0
NEWTON_STEPS = 8
NEAREST = 4
"""Vertices whose motion a point of the surface follows."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class MovingLine:
    """Places along a line at every phase of the cycle, and their motion.

    Attributes:
        places_mm: (p, n, 3) at evenly spread phases from 0 on, STEP_MM apart along the line.
        rates_mm: (p, n, 3) their derivative by phase, mm a cycle.
    """

    places_mm: FloatArray
    rates_mm: FloatArray

    @property
    def length_mm(self) -> float:
        return STEP_MM * float(self.places_mm.shape[1] - 1)

    def at(self, along_mm: float, phase: float) -> FloatArray:
        """(3,) place."""
        return _between(self.places_mm, along_mm, phase)

    def rate_mm(self, along_mm: float, phase: float) -> FloatArray:
        """(3,) motion of a place with the beat, mm a cycle."""
        return _between(self.rates_mm, along_mm, phase)

    def tangent(self, along_mm: float) -> FloatArray:
        """(3,) mm along the line a mm, at phase 0."""
        here = min(max(along_mm, 0.0), self.length_mm - STEP_MM)
        return np.asarray((self.at(here + STEP_MM, 0.0) - self.at(here, 0.0)) / STEP_MM)


def moving_line(surface: MovingSurface, site: Site, length_mm: float, depth_mm: float) -> MovingLine:
    """A straight line over a site, projected onto the surface at phase 0, riding on it from then on.

    Args:
        surface: true.
        length_mm: 0 for a point.
        depth_mm: signed distance of its places to the surface, positive inside.
    """
    count = 1 + round(length_mm / STEP_MM)
    along = (np.arange(count) - 0.5 * (count - 1)) * STEP_MM
    base = _at_depth(surface, site.point_mm + along[:, None] * site.slide, 0.0, 0.0)
    resting = surface.at(0.0)
    apart = np.linalg.norm(base[:, None] - resting[None], axis=2)
    nearest = np.argsort(apart, axis=1)[:, :NEAREST]
    weight = 1.0 / (np.take_along_axis(apart, nearest, axis=1) + 1e-3)
    weight /= weight.sum(axis=1, keepdims=True)
    phases = np.arange(PHASES) / PHASES
    places = np.empty((PHASES, count, 3))
    for i, phase in enumerate(phases.tolist()):
        moved = (surface.at(phase) - resting)[nearest]
        places[i] = _at_depth(surface, base + np.einsum("ij,ijk->ik", weight, moved), phase, depth_mm)
    closed = np.concatenate([places, places[:1]])
    rates = CubicSpline(np.append(phases, 1.0), closed, bc_type="periodic")(phases, 1)
    return MovingLine(places, rates)


def _at_depth(surface: MovingSurface, xyz_mm: FloatArray, phase: float, depth_mm: float) -> FloatArray:
    """(n, 3) the points moved along the gradient until they are so deep."""
    out = np.array(xyz_mm)
    at = np.full(len(out), phase)
    for _ in range(NEWTON_STEPS):
        distance, gradient = surface.distance(out, at)
        out += (depth_mm - distance)[:, None] * gradient
    return out


def _between(table: FloatArray, along_mm: float, phase: float) -> FloatArray:
    p, n = table.shape[:2]
    u, v = (phase % 1.0) * p, min(max(along_mm / STEP_MM, 0.0), n - 1.0)
    i, k = int(u) % p, min(int(v), max(n - 2, 0))
    a, b, j, m = u - int(u), v - k, (i + 1) % p, min(k + 1, n - 1)
    low = (1.0 - b) * table[i, k] + b * table[i, m]
    high = (1.0 - b) * table[j, k] + b * table[j, m]
    return np.asarray((1.0 - a) * low + a * high)
