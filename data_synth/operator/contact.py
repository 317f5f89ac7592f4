"""True contact of a tool tip: exact signed distance to the true moving surface."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from data_synth.kernels.closest_triangle import Mesh, signed_distances
from dvf_ig.core import FloatArray, IntArray, InvalidInputError, ToolTruth, read_only_arrays

MAX_INTERPOLATION_ERROR_MM = 0.005
"""Largest distance of the cached surface from the anatomy at any phase."""

FIRST_SAMPLES = 48
SMALLEST_STEP = 1.0 / 3072
_CLUSTER = 24


class BeatClock(Protocol):
    """Part of a true clock that contact and tool paths need."""

    def phi(self, t_s: FloatArray) -> FloatArray:
        """Compute the fraction of the running RR interval, in [0, 1)."""

    def model_phase(self, t_s: FloatArray) -> FloatArray:
        """Compute the heart's phase in the pre-operative cycle, in [0, 1)."""


class MovingMesh(Protocol):
    """Part of a beating anatomy that contact needs."""

    @property
    def surface_triangles(self) -> IntArray: ...

    def surface_vertices(self, model_phase: float) -> FloatArray: ...


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class MovingSurface:
    """Closed mesh at any phase of the cycle, with distances to it.

    Attributes:
        phases: (p,) cached phases, increasing from 0; their spacing follows the speed of the motion.
        mesh: the surface at these phases, linear between neighbouring ones, cyclic.
        interpolation_error_mm: bound on the vertex error of the linear interpolation.
    """

    phases: FloatArray
    mesh: Mesh
    interpolation_error_mm: float

    @classmethod
    def of(cls, anatomy: MovingMesh) -> "MovingSurface":
        """Cache the surface of `anatomy` densely enough for linear interpolation.

        The anatomy is sampled in steps that are halved until four-point cubic interpolation matches it
        half-way between samples. The cubic then fills in phases until linear interpolation is as good.

        Raises:
            InvalidInputError: the mesh is not closed, or moves too abruptly to be interpolated.
        """
        sampled_at, exact, cubic_error = _exact_samples(anatomy)
        phases, vertices, linear_error = _filled_in(sampled_at, exact)
        triangles = np.array(anatomy.surface_triangles, dtype=np.int64)
        return cls(phases, _indexed(vertices, triangles), cubic_error + linear_error)

    @property
    def vertices_mm(self) -> FloatArray:
        """Vertices (p, v, 3) at the cached phases."""
        return self.mesh.vertices

    @property
    def triangles(self) -> IntArray:
        """(m, 3), outward."""
        return self.mesh.triangles

    def at(self, model_phase: float) -> FloatArray:
        """Interpolate (v, 3) vertices at one phase."""
        low, high, weight = self._bracket(np.array([model_phase]))
        return np.asarray((1 - weight[0]) * self.vertices_mm[low[0]] + weight[0] * self.vertices_mm[high[0]])

    def distance(self, points_mm: FloatArray, model_phase: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute signed distances (n,) mm, positive inside, and unit gradients (n, 3), at each own phase."""
        points = np.array(points_mm, dtype=np.float64, order="C")
        low, high, weight = self._bracket(np.broadcast_to(model_phase, len(points)))
        distance, gradient = np.empty(len(points)), np.empty((len(points), 3))
        signed_distances(points, low, high, weight, self.mesh, distance, gradient)
        return distance, gradient

    def _bracket(self, model_phase: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Find neighbouring cached phases and the weight of the second."""
        phase = np.asarray(model_phase, dtype=np.float64) % 1.0
        low = np.searchsorted(self.phases, phase, side="right") - 1
        edges = np.append(self.phases, 1.0)
        weight = (phase - edges[low]) / (edges[low + 1] - edges[low])
        return low.astype(np.int64), ((low + 1) % len(self.phases)).astype(np.int64), weight


def tool_truth(surface: MovingSurface, clock: BeatClock, t_s: FloatArray, tip_mr_mm: FloatArray) -> ToolTruth:
    """Compute the contact of the tip at every tick."""
    phase = clock.model_phase(t_s)
    distance, gradient = surface.distance(tip_mr_mm, phase)
    return ToolTruth(t_s, tip_mr_mm, clock.phi(t_s), phase, distance, gradient)


def _exact_samples(anatomy: MovingMesh) -> tuple[FloatArray, FloatArray, float]:
    """Sample phases (n,), vertices (n, v, 3), and a bound on the cubic interpolation's error, mm.

    The error is measured half-way between samples, and those middles then become samples: that divides
    it by 4 at jumps of the acceleration, by more elsewhere.
    """
    phases = np.arange(FIRST_SAMPLES) / FIRST_SAMPLES
    vertices = [anatomy.surface_vertices(phase) for phase in phases.tolist()]
    waiting, worst = np.arange(FIRST_SAMPLES), 0.0
    while True:
        steps = np.diff(np.append(phases, 1.0))[waiting]
        lows = phases[waiting]
        middles = lows + 0.5 * steps
        middle_vertices = [anatomy.surface_vertices(phase) for phase in middles.tolist()]
        guesses = (_cubic(phases, vertices, i, 0.5) for i in waiting.tolist())
        errors = np.array(
            [np.linalg.norm(g - f, axis=1).max() / 4.0 for g, f in zip(guesses, middle_vertices, strict=True)]
        )
        good = errors <= 0.5 * MAX_INTERPOLATION_ERROR_MM
        worst = max(worst, float(errors[good].max(initial=0.0)))
        order = np.argsort(np.append(phases, middles), kind="stable")
        phases, joined = np.append(phases, middles)[order], vertices + middle_vertices
        vertices = [joined[k] for k in order.tolist()]
        if good.all():
            return phases, np.stack(vertices), worst
        if steps[~good].min() < SMALLEST_STEP:
            k = int(errors.argmax())
            raise InvalidInputError(
                f"the true surface jumps by {4 * errors[k]:.3g} mm at phase {middles[k]:.4f}; "
                "it must move smoothly"
            )
        waiting = np.sort(np.searchsorted(phases, np.append(lows[~good], middles[~good])))


def _cubic(
    phases: FloatArray, vertices: list[FloatArray] | FloatArray, interval: int, u: float
) -> FloatArray:
    """Interpolate (v, 3) at fraction `u` of an interval by the cubic through two samples on each side."""
    count = len(phases)
    around = [interval + k for k in (-1, 0, 1, 2)]
    at = np.array([phases[k % count] + k // count for k in around])
    x = at[1] + u * (at[2] - at[1])
    out = np.zeros_like(vertices[0])
    for k, node in enumerate(around):
        others = np.delete(at, k)
        out += float(np.prod((x - others) / (at[k] - others))) * vertices[node % count]
    return out


def _filled_in(sampled_at: FloatArray, exact: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Fill in phases and vertices as the acceleration needs; also return the linear interpolation's error."""
    phases: list[float] = []
    vertices: list[FloatArray] = []
    worst, count = 0.0, len(sampled_at)
    steps = np.diff(np.append(sampled_at, 1.0))
    for i in range(count):
        bend = _cubic(sampled_at, exact, i, 0.5) - 0.5 * (exact[i] + exact[(i + 1) % count])
        sag = float(np.linalg.norm(bend, axis=1).max())
        parts = max(1, int(np.ceil(np.sqrt(sag / (0.5 * MAX_INTERPOLATION_ERROR_MM)))))
        worst = max(worst, sag / parts**2)
        phases += [float(sampled_at[i] + steps[i] * k / parts) for k in range(parts)]
        vertices += [_cubic(sampled_at, exact, i, k / parts) for k in range(parts)]
    return np.array(phases), np.stack(vertices), worst


def _indexed(vertices: FloatArray, triangles: IntArray) -> Mesh:
    """Sort the mesh into clusters, with the neighbours of each vertex and edge."""
    order, clusters = _clustered(vertices[0][triangles].mean(axis=1))
    triangles = np.ascontiguousarray(triangles[order])
    neighbour = _neighbours(triangles)
    start, around = _triangles_around(triangles, vertices.shape[1])
    centers, radii = _bounding_spheres(vertices, triangles, clusters)
    return Mesh(vertices, triangles, start, around, neighbour, clusters, centers, radii)


def _clustered(centroids: FloatArray) -> tuple[IntArray, IntArray]:
    """Cluster triangles by median splits along the longest axis: their order and the clusters' offsets."""
    clusters: list[IntArray] = []
    waiting = [np.arange(len(centroids))]
    while waiting:
        members = waiting.pop()
        if len(members) <= _CLUSTER:
            clusters.append(members)
            continue
        axis = int(np.ptp(centroids[members], axis=0).argmax())
        members = members[np.argsort(centroids[members, axis], kind="stable")]
        half = len(members) // 2
        waiting += [members[half:], members[:half]]
    return np.concatenate(clusters), np.cumsum([0, *(len(members) for members in clusters)])


def _bounding_spheres(
    vertices: FloatArray, triangles: IntArray, clusters: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Compute each cluster's sphere at each phase; between phases its radius is the larger."""
    centers = np.empty((len(vertices), len(clusters) - 1, 3))
    radii = np.empty((len(vertices), len(clusters) - 1))
    for c, (first, last) in enumerate(pairwise(clusters.tolist())):
        members = vertices[:, np.unique(triangles[first:last])]
        centers[:, c] = members.mean(axis=1)
        radii[:, c] = np.linalg.norm(members - centers[:, c, None], axis=2).max(axis=1) + 1e-9
    return centers, radii


def _triangles_around(triangles: IntArray, vertices: int) -> tuple[IntArray, IntArray]:
    corner_of = np.argsort(triangles.ravel(), kind="stable")
    start = np.searchsorted(triangles.ravel()[corner_of], np.arange(vertices + 1))
    return start.astype(np.int64), (corner_of // 3).astype(np.int64)


def _neighbours(triangles: IntArray) -> IntArray:
    """Find the (m, 3) triangle across edge k (corner k to k+1).

    Raises:
        InvalidInputError: an edge without exactly one oppositely oriented partner.
    """
    big = int(triangles.max()) + 1
    following = np.roll(triangles, -1, axis=1)
    key, partner = (triangles * big + following).ravel(), (following * big + triangles).ravel()
    order = np.argsort(key, kind="stable")
    at = np.minimum(np.searchsorted(key[order], partner), len(key) - 1)
    open_edges = int(np.count_nonzero(key[order][at] != partner))
    repeated = len(key) - len(np.unique(key))
    if open_edges or repeated:
        raise InvalidInputError(
            f"the true surface has {open_edges} open and {repeated} repeated edges; needed a closed, "
            "consistently oriented mesh"
        )
    return np.asarray(order[at] // 3, dtype=np.int64).reshape(-1, 3)
