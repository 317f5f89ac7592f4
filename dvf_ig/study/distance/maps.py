"""Ways to make a distance map, held against the exact distance to the mesh. Uses SimpleITK.

Every way starts from the same mask (or the mesh it was cut from) on the same grid, and its map is fitted by
the same splines: knots every second voxel, plain least squares as in Ren 2008, eq. 2.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from dvf_ig.core import BoolArray, FloatArray, Grid, IntArray, InvalidInputError, Mesh, read_only_arrays
from dvf_ig.preop import (
    AxisSolver,
    SplineField,
    angle_deg,
    build_triangle_tree,
    dilation_distance_mm,
    field_errors,
    fit_coefficients,
    fit_weighted,
    inside_mask,
    signed_distance_mm,
    smooth_normals,
    surface_of_mask,
    surface_weights,
    vertex_normals,
)
from dvf_ig.preop.distance.signed import LEVELS
from dvf_ig.preop.spline.fit import SAMPLES_PER_KNOT, AxisSolvers

WIDE_MM, NEAR_MM = 15.0, 2.0
BAND_MM = 4.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class MapScore:
    """One way of making the map.

    Attributes:
        name: what it is.
        seconds: for the map alone.
        rms_wide_mm, rms_near_mm: at the voxels within 15 mm and 2 mm of the surface, before any fit.
        surface_mean_mm, surface_sd_mm: |d|/|∇d| of the fitted spline at random points of the mesh.
        normal_median_deg, normal_p95_deg: angle between the fitted ∇d and the smooth surface's normal at
            points within 2 mm of it.
        map_normal_median_deg, map_normal_p95_deg: the same for the map before the fit, by central
            differences at voxels within 2 mm of the surface.
        distance_mm: (nx, ny, nz) the map.
    """

    name: str
    seconds: float
    rms_wide_mm: float
    rms_near_mm: float
    surface_mean_mm: float
    surface_sd_mm: float
    normal_median_deg: float
    normal_p95_deg: float
    map_normal_median_deg: float
    map_normal_p95_deg: float
    distance_mm: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """All ways on one surface, with the exact distance they are held against."""

    scores: tuple[MapScore, ...]
    grid: Grid
    exact_mm: FloatArray


Way = Callable[[Mesh, BoolArray, Grid], FloatArray]


def compare_distance_maps(
    mesh: Mesh,
    *,
    voxels: int = 128,
    points: int = 20_000,
    rng: np.random.Generator,
    report: Callable[[float], None] = lambda _: None,
) -> Comparison:
    """Every way on one closed surface.

    Args:
        mesh: closed, outward orientation.
        voxels: along the longest side of the box, which reaches 15 mm beyond the surface.
        points: random points of the surface at which the fits are judged; a quarter of them for the normals.
        report: told the share of the ways that is done.
    Raises:
        InvalidInputError: fewer than 24 voxels.
    """
    if voxels < 24:
        raise InvalidInputError(f"{voxels} voxels along the longest side; needed at least 24")
    grid = _voxel_grid(mesh, voxels)
    mask = inside_mask(grid.to_index(mesh.vertices_mm), mesh.triangles, grid.shape)
    exact_mm = signed_distance_mm(mesh, grid, WIDE_MM)
    judge = _Judge.of(mesh, grid, exact_mm, points, rng)
    scores = []
    for name, way in WAYS.items():
        start = time.perf_counter()
        distance_mm = way(mesh, mask, grid)
        seconds = time.perf_counter() - start
        scores.append(judge.score(name, distance_mm, seconds, surface_first=name == SURFACE_FIRST))
        report(len(scores) / len(WAYS))
    return Comparison(tuple(scores), grid, exact_mm)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Judge:
    """What every way is held against; each sees the same random points.

    Attributes:
        near: indices of random voxels within 2 mm of the surface.
        inward: (n, 3) normal of the smooth surface there.
    """

    mesh: Mesh
    grid: Grid
    exact_mm: FloatArray
    solvers: AxisSolvers
    points: int
    seed: int
    near: tuple[IntArray, ...]
    inward: FloatArray

    @classmethod
    def of(
        cls, mesh: Mesh, grid: Grid, exact_mm: FloatArray, points: int, rng: np.random.Generator
    ) -> "_Judge":
        x, y, z = (AxisSolver.of((n - 1) // SAMPLES_PER_KNOT) for n in grid.shape)
        voxels = np.argwhere(np.abs(exact_mm) <= NEAR_MM)
        chosen = np.sort(rng.permutation(len(voxels))[: points // 4])
        tree = build_triangle_tree(mesh.vertices_mm, mesh.triangles)
        nearest = tree.nearest(grid.to_mm(voxels[chosen].astype(np.float64)))
        inward = -smooth_normals(mesh, vertex_normals(mesh), nearest)
        near = tuple(voxels[chosen].T)
        return cls(mesh, grid, exact_mm, (x, y, z), points, int(rng.integers(2**63)), near, inward)

    def score(self, name: str, distance_mm: FloatArray, seconds: float, *, surface_first: bool) -> MapScore:
        knot_mm = SAMPLES_PER_KNOT * float(self.grid.spacing_mm[0])
        if surface_first:
            coefficients = fit_weighted(distance_mm, surface_weights(distance_mm, knot_mm), self.solvers)
        else:
            coefficients = fit_coefficients(distance_mm, self.solvers)
        field = SplineField(coefficients[None], self.grid.origin_mm, knot_mm)
        no_caps = np.zeros(len(self.mesh.triangles), dtype=np.bool_)
        errors = field_errors(field, self.mesh, no_caps, self.points, np.random.default_rng(self.seed))
        slopes = np.stack(
            [np.asarray(np.gradient(distance_mm, axis=axis))[self.near] for axis in range(3)], axis=1
        )
        map_normal_deg = angle_deg(slopes, self.inward)
        return MapScore(
            name,
            seconds,
            self._rms(distance_mm, WIDE_MM),
            self._rms(distance_mm, NEAR_MM),
            float(errors.surface_mm.mean()),
            float(errors.surface_mm.std()),
            float(np.median(errors.normal_deg)),
            float(np.percentile(errors.normal_deg, 95)),
            float(np.median(map_normal_deg)),
            float(np.percentile(map_normal_deg, 95)),
            distance_mm,
        )

    def _rms(self, distance_mm: FloatArray, within_mm: float) -> float:
        near = np.abs(self.exact_mm) <= within_mm
        return float(np.sqrt(np.mean((distance_mm[near] - self.exact_mm[near]) ** 2)))


def _voxel_grid(mesh: Mesh, voxels: int) -> Grid:
    """Cubic voxels over the surface and 15 mm around it; sample counts as `signed_distance_mm` asks."""
    lower = mesh.vertices_mm.min(axis=0) - WIDE_MM
    upper = mesh.vertices_mm.max(axis=0) + WIDE_MM
    spacing_mm = float((upper - lower).max()) / voxels
    step = 1 << LEVELS
    shape = [step * int(np.ceil(side / (step * spacing_mm) - 1e-9)) + 1 for side in upper - lower]
    return Grid.axis_aligned(mesh.frame, (shape[0], shape[1], shape[2]), lower, spacing_mm)


def _dilation(neighbours: int) -> Way:
    return lambda _, mask, grid: dilation_distance_mm(mask, float(grid.spacing_mm[0]), neighbours)


def _euclidean(_: Mesh, mask: BoolArray, grid: Grid) -> FloatArray:
    """From voxel centre to voxel centre of the other side: half a voxel too far."""
    inside = distance_transform_edt(mask, sampling=grid.spacing_mm)
    outside = distance_transform_edt(~mask, sampling=grid.spacing_mm)
    return np.asarray(inside - outside)


def _euclidean_half(mesh: Mesh, mask: BoolArray, grid: Grid) -> FloatArray:
    raw = _euclidean(mesh, mask, grid)
    return np.asarray(raw - 0.5 * float(grid.spacing_mm[0]) * np.sign(raw))


def _maurer(_: Mesh, mask: BoolArray, grid: Grid) -> FloatArray:
    """SimpleITK's signed Maurer map; it is zero at the last voxels inside, half a voxel below the surface."""
    import SimpleITK

    image = SimpleITK.GetImageFromArray(mask.astype(np.uint8))
    image.SetSpacing([float(h) for h in grid.spacing_mm])
    found = SimpleITK.SignedMaurerDistanceMap(
        image, insideIsPositive=True, squaredDistance=False, useImageSpacing=True
    )
    return np.asarray(SimpleITK.GetArrayFromImage(found), dtype=np.float64)


def _maurer_half(mesh: Mesh, mask: BoolArray, grid: Grid) -> FloatArray:
    return _maurer(mesh, mask, grid) + 0.5 * float(grid.spacing_mm[0])


def _smoothed(_: Mesh, mask: BoolArray, grid: Grid) -> FloatArray:
    """Gaussian, marching cubes, then the exact distance to that mesh."""
    return signed_distance_mm(surface_of_mask(mask, grid), grid, BAND_MM)


def _exact(mesh: Mesh, _: BoolArray, grid: Grid) -> FloatArray:
    return signed_distance_mm(mesh, grid, BAND_MM)


SURFACE_FIRST = "exact to the mesh, surface first"

WAYS: dict[str, Way] = {
    "dilation, 6 neighbours": _dilation(6),
    "dilation, 18 neighbours": _dilation(18),
    "dilation, 26 neighbours": _dilation(26),
    "Euclidean on the mask": _euclidean,
    "Euclidean on the mask, -h/2": _euclidean_half,
    "SimpleITK SignedMaurer": _maurer,
    "SimpleITK SignedMaurer, +h/2": _maurer_half,
    "Gaussian, marching cubes, exact": _smoothed,
    "exact to the mesh": _exact,
    SURFACE_FIRST: _exact,
}
"""The last is what models are built with: the same map, fitted with weights that put the surface first."""
