"""Methods that make a distance map, compared with the exact distance to the mesh. Uses SimpleITK.

Every method starts from the same mask (or the mesh it was cut from) on the same grid, and its map is fitted
by the same splines: knots every second voxel, plain least squares as in Ren 2008, eq. 2.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from dvf_ig.core import (
    BoolArray,
    FloatArray,
    Grid,
    IntArray,
    InvalidInputError,
    Mesh,
    Progress,
    part_of,
    read_only_arrays,
    untold,
)
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
    """One method, over all surfaces.

    Attributes:
        name: of the method.
        seconds: for the map alone, the mean of the surfaces.
        rms_wide_mm, rms_near_mm: at the voxels within 15 mm and 2 mm of the surface, before any fit.
        surface_mean_mm, surface_sd_mm: |d|/|∇d| of the fitted spline at random points of the mesh.
        normal_median_deg, normal_p95_deg: angle between the fitted ∇d and the smooth surface's normal at
            points within 2 mm of it.
        map_normal_median_deg, map_normal_p95_deg: the same for the map before the fit, by central
            differences at voxels within 2 mm of the surface.
        distance_mm: (nx, ny, nz) the map of the first surface.
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
    """All methods; the grid of the first surface, and the exact distance to it."""

    scores: tuple[MapScore, ...]
    grid: Grid
    exact_mm: FloatArray


Method = Callable[[Mesh, BoolArray, Grid], FloatArray]


def compare_distance_maps(
    meshes: Sequence[Mesh],
    rngs: Sequence[np.random.Generator],
    *,
    voxels: int = 128,
    points: int = 20_000,
    progress: Progress = untold,
) -> Comparison:
    """Every method on some closed surfaces; errors are pooled over them.

    Args:
        meshes: closed, outward orientation; at least one.
        rngs: one for each mesh, draws the points at which the fits are judged.
        voxels: along the longest side of the box, which reaches 15 mm beyond the surface.
        points: random points of each surface; a quarter as many voxels near it for the normals.
        progress: told the share of the work that is done.
    Raises:
        InvalidInputError: fewer than 24 voxels.
    """
    if voxels < 24:
        raise InvalidInputError(f"{voxels} voxels along the longest side; needed at least 24")
    references: list[_Reference] = []
    maps: dict[str, FloatArray] = {}
    errors: dict[str, list[_MapErrors]] = {name: [] for name in METHODS}
    for k, (mesh, rng) in enumerate(zip(meshes, rngs, strict=True)):
        reference = _Reference.of(mesh, voxels, points, rng)
        mask = inside_mask(reference.grid.to_index(mesh.vertices_mm), mesh.triangles, reference.grid.shape)
        references.append(reference)
        for done, (name, method) in enumerate(METHODS.items(), 1):
            start = time.perf_counter()
            distance_mm = method(mesh, mask, reference.grid)
            seconds = time.perf_counter() - start
            maps.setdefault(name, distance_mm)
            errors[name].append(reference.errors(distance_mm, seconds, surface_first=name == SURFACE_FIRST))
            part_of(progress, k, len(meshes))(done / len(METHODS))
    scores = tuple(_score(name, errors[name], maps[name]) for name in METHODS)
    return Comparison(scores, references[0].grid, references[0].exact_mm)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _MapErrors:
    """Errors of one method on one surface: see `MapScore`.

    Attributes:
        wide_squares_mm2, near_squares_mm2: squared errors at the voxels within 15 mm and 2 mm.
        surface_mm, normal_deg, map_normal_deg: at each point.
    """

    seconds: float
    wide_squares_mm2: FloatArray
    near_squares_mm2: FloatArray
    surface_mm: FloatArray
    normal_deg: FloatArray
    map_normal_deg: FloatArray


def _score(name: str, errors: Sequence[_MapErrors], distance_mm: FloatArray) -> MapScore:
    surface_mm = np.concatenate([e.surface_mm for e in errors])
    normal_deg = np.concatenate([e.normal_deg for e in errors])
    map_normal_deg = np.concatenate([e.map_normal_deg for e in errors])
    return MapScore(
        name=name,
        seconds=float(np.mean([e.seconds for e in errors])),
        rms_wide_mm=float(np.sqrt(np.mean(np.concatenate([e.wide_squares_mm2 for e in errors])))),
        rms_near_mm=float(np.sqrt(np.mean(np.concatenate([e.near_squares_mm2 for e in errors])))),
        surface_mean_mm=float(surface_mm.mean()),
        surface_sd_mm=float(surface_mm.std()),
        normal_median_deg=float(np.median(normal_deg)),
        normal_p95_deg=float(np.percentile(normal_deg, 95)),
        map_normal_median_deg=float(np.median(map_normal_deg)),
        map_normal_p95_deg=float(np.percentile(map_normal_deg, 95)),
        distance_mm=distance_mm,
    )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    """What every method is compared with on one surface; each sees the same random points.

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
    def of(cls, mesh: Mesh, voxels: int, points: int, rng: np.random.Generator) -> "_Reference":
        grid = _voxel_grid(mesh, voxels)
        exact_mm = signed_distance_mm(mesh, grid, WIDE_MM)
        x, y, z = (AxisSolver.of((n - 1) // SAMPLES_PER_KNOT) for n in grid.shape)
        close = np.argwhere(np.abs(exact_mm) <= NEAR_MM)
        chosen = np.sort(rng.permutation(len(close))[: points // 4])
        tree = build_triangle_tree(mesh.vertices_mm, mesh.triangles)
        nearest = tree.nearest(grid.to_mm(close[chosen].astype(np.float64)))
        inward = -smooth_normals(mesh, vertex_normals(mesh), nearest)
        near = tuple(close[chosen].T)
        return cls(mesh, grid, exact_mm, (x, y, z), points, int(rng.integers(2**63)), near, inward)

    def errors(self, distance_mm: FloatArray, seconds: float, *, surface_first: bool) -> _MapErrors:
        knot_mm = SAMPLES_PER_KNOT * float(self.grid.spacing_mm[0])
        if surface_first:
            coefficients = fit_weighted(distance_mm, surface_weights(distance_mm, knot_mm), self.solvers)
        else:
            coefficients = fit_coefficients(distance_mm, self.solvers)
        field = SplineField(coefficients[None], self.grid.origin_mm, knot_mm)
        no_caps = np.zeros(len(self.mesh.triangles), dtype=np.bool_)
        fit = field_errors(field, self.mesh, no_caps, self.points, np.random.default_rng(self.seed))
        slopes = np.stack(
            [np.asarray(np.gradient(distance_mm, axis=axis))[self.near] for axis in range(3)], axis=1
        )
        return _MapErrors(
            seconds,
            self._squares_mm2(distance_mm, WIDE_MM),
            self._squares_mm2(distance_mm, NEAR_MM),
            fit.surface_mm,
            fit.normal_deg,
            angle_deg(slopes, self.inward),
        )

    def _squares_mm2(self, distance_mm: FloatArray, within_mm: float) -> FloatArray:
        near = np.abs(self.exact_mm) <= within_mm
        return np.asarray((distance_mm[near] - self.exact_mm[near]) ** 2)


def _voxel_grid(mesh: Mesh, voxels: int) -> Grid:
    """Cubic voxels over the surface and 15 mm around it; sample counts as `signed_distance_mm` asks."""
    lower = mesh.vertices_mm.min(axis=0) - WIDE_MM
    upper = mesh.vertices_mm.max(axis=0) + WIDE_MM
    spacing_mm = float((upper - lower).max()) / voxels
    step = 1 << LEVELS
    shape = [step * int(np.ceil(side / (step * spacing_mm) - 1e-9)) + 1 for side in upper - lower]
    return Grid.axis_aligned(mesh.frame, (shape[0], shape[1], shape[2]), lower, spacing_mm)


def _dilation(neighbours: int) -> Method:
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

METHODS: dict[str, Method] = {
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
