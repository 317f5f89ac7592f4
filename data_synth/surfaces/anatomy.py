"""Beating anatomy built from real corresponding surfaces."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates

from data_synth.heart.anatomical_points import with_box_grid
from data_synth.heart.beating_anatomy import MARGIN_MM, REFERENCE_SPACING_MM
from data_synth.heart.mismatch import (
    UNTOUCHED,
    SmoothField,
    SurgicalChange,
    random_mismatch,
    surgical_field,
    tabulated_inverse,
)
from data_synth.heart.reference import Layers, ReferenceMap, build_reference, tissue_at
from data_synth.heart.shapes import outside_layers
from data_synth.heart.tissue import Tissue
from data_synth.kernels import distance
from data_synth.seeds import child_rng
from dvf_ig.core import (
    FloatArray,
    IntArray,
    InvalidInputError,
    Landmarks,
    Points,
    Preop,
    SurfaceSeries,
    read_only_arrays,
)
from dvf_ig.core.space.mesh import enclosed_volume_mm3

from .atria import AtrialStub
from .closing import ClosedSeries, closed_series, refined
from .motion import GriddedMotion, SurfaceMotion, dense_motion, periodic_spline

EPICARDIAL, LV, RV = "EPICARDIAL", "LV_ENDOCARDIAL", "RV_ENDOCARDIAL"
MIN_VERTICES = 8000
_BAND_MM = {EPICARDIAL: 14.0, LV: 6.0, RV: 6.0}


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class DepthGrid:
    """Signed distance to a closed surface, positive inside, clipped to its band; linear between nodes."""

    values_mm: NDArray[np.float32]
    origin_mm: FloatArray
    spacing_mm: float

    def at(self, xyz_mm: FloatArray) -> FloatArray:
        index = ((xyz_mm - self.origin_mm) / self.spacing_mm).T
        return np.asarray(map_coordinates(self.values_mm, index, order=1, mode="nearest"), dtype=np.float64)


def depth_grid(
    vertices_mm: FloatArray, triangles: IntArray, box_mm: FloatArray, spacing_mm: float, band_mm: float
) -> DepthGrid:
    """Compute depth, exact within `band_mm` of the surface, ±band beyond; sign by parity along z."""
    count = np.ceil((box_mm[1] - box_mm[0]) / spacing_mm).astype(int) + 1
    squared = np.full(tuple(count), band_mm**2)
    flips = np.zeros((count[0], count[1], count[2] + 1), dtype=np.bool_)
    mesh = (
        np.ascontiguousarray(vertices_mm),
        np.ascontiguousarray(triangles),
        np.array(box_mm[0]),
        spacing_mm,
    )
    distance.band_distance(*mesh, band_mm, squared)
    distance.mark_crossings(*mesh, flips)
    inside = np.logical_xor.accumulate(flips[..., :-1], axis=2)
    values = np.where(inside, 1.0, -1.0) * np.sqrt(squared)
    return DepthGrid(values.astype(np.float32), np.array(box_mm[0]), spacing_mm)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SurfaceShapes:
    """Tissues at end-diastole bounded by real surfaces, frame "mr"."""

    epicardium: DepthGrid
    lv: DepthGrid | None
    rv: DepthGrid | None
    center_mm: FloatArray
    atria: AtrialStub | None = None
    base: Tissue = Tissue.LV_MYOCARDIUM

    def organ(self, xyz_mm: FloatArray) -> FloatArray:
        return self.epicardium.at(xyz_mm)

    def inside(self, xyz_mm: FloatArray, organ: FloatArray) -> Layers:
        layers: Layers = [(Tissue.LV_MYOCARDIUM, organ)]
        if self.atria is not None:
            layers += self.atria.layers(xyz_mm, organ)
        if self.rv is not None:
            rv = self.rv.at(xyz_mm)
            # within reach of the right ventricle and not facing the left one: its free wall
            free = np.minimum(rv + 5.0, 5.0 - organ)
            layers += [(Tissue.RV_WALL, free), (Tissue.RV_BLOOD, rv)]
        if self.lv is not None:
            layers.append((Tissue.LV_BLOOD, self.lv.at(xyz_mm)))
        return layers

    def inside_ultrasound_only(self, xyz_mm: FloatArray) -> Layers:
        return []

    def outside(self, xyz_mm: FloatArray, organ: FloatArray) -> Layers:
        return outside_layers(xyz_mm - self.center_mm, organ)


@dataclass(frozen=True, eq=False)
class SurfaceAnatomy:
    """Real surfaces, moved by periodic cubic interpolation of their vertices.

    The epicardium is exactly the interpolated surface (plus mismatch); tissue follows a dense motion fitted
    to all surfaces, and agrees with them to a few tenths of a millimetre.

    Attributes:
        series: the surfaces as given.
        closed: the closed (and, for the epicardium, refined) surfaces by name.
        splines: vertex trajectories over the cycle by name.
        mismatch: pre-operative to intra-operative difference.
        atria: stubs of them; None: the surfaces are complete.
    """

    series: tuple[SurfaceSeries, ...]
    closed: dict[str, ClosedSeries]
    splines: dict[str, CubicSpline]
    mismatch: SmoothField
    es_fraction: float
    atria: AtrialStub | None = None

    @property
    def rr_s(self) -> float:
        return self.series[0].timing.rr_s

    @property
    def box_mm(self) -> FloatArray:
        vertices = self.splines[EPICARDIAL](0.0)
        return np.array([vertices.min(axis=0), vertices.max(axis=0)])

    @property
    def surface_triangles(self) -> IntArray:
        return self.closed[EPICARDIAL].triangles

    @cached_property
    def shapes(self) -> SurfaceShapes:
        grids = {
            name: depth_grid(
                self.splines[name](0.0),
                closed.triangles,
                self._wide_box(),
                REFERENCE_SPACING_MM,
                _BAND_MM[name],
            )
            for name, closed in self.closed.items()
        }
        center = self.box_mm.mean(axis=0)
        return SurfaceShapes(grids[EPICARDIAL], grids.get(LV), grids.get(RV), center, self.atria)

    @cached_property
    def reference(self) -> ReferenceMap:
        return build_reference(self.shapes, self._wide_box(), REFERENCE_SPACING_MM)

    @cached_property
    def dense(self) -> GriddedMotion:
        vertices = np.concatenate([c.vertices_mm for c in self.closed.values()], axis=1)
        reference = np.concatenate([self.splines[name](0.0) for name in self.closed])
        return dense_motion(vertices, self.series[0].timing, reference, self._wide_box())

    @cached_property
    def inverse_motion(self) -> SurfaceMotion:
        field = None if self.mismatch.rms_mm == 0 else tabulated_inverse(self.mismatch, self._wide_box())
        return SurfaceMotion(self.dense, self.dense.backward(), field)

    def material(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        return self.inverse_motion.pull_back(xyz_mm, model_phase)

    def tissue(self, xyz_mm: FloatArray, model_phase: float) -> NDArray[np.uint8]:
        return tissue_at(self.shapes, self.material(xyz_mm, model_phase))

    def surface_vertices(self, model_phase: float) -> FloatArray:
        return self.mismatch.forward(np.asarray(self.splines[EPICARDIAL](model_phase % 1.0)))

    def targets(self) -> Landmarks:
        names, points = self._anatomical_points()
        spread = _spread_vertices(self.splines[EPICARDIAL](0.0), 8)
        names += tuple(f"epicardium_{i + 1}" for i in range(len(spread)))
        return with_box_grid("mr", names, np.concatenate([points, spread]), self.box_mm)

    def landmarks(self) -> Landmarks:
        vertices = self.splines[EPICARDIAL](0.0)
        openings = self.closed[EPICARDIAL].openings[:4]
        points = {f"opening_{i + 1}": vertices[opening] for i, opening in enumerate(openings)}
        points["apex"] = _apex(vertices, openings)
        for axis, name in enumerate(("leftmost", "rearmost", "uppermost")):
            points[name] = vertices[vertices[:, axis].argmax()]
        return Landmarks(tuple(points), Points("mr", np.array(list(points.values()))))

    def preop(self) -> Preop:
        """Return the surfaces as given, the data before the intervention."""
        return Preop(patient_id=self.series[0].patient_id, surfaces=self.series, surface=EPICARDIAL)

    def _anatomical_points(self) -> tuple[tuple[str, ...], FloatArray]:
        names: list[str] = []
        points = []
        for name, closed in self.closed.items():
            vertices = self.splines[name](0.0)
            short = name.split("_")[0].lower()
            names.append(f"{short}_apex")
            points.append(_apex(vertices, closed.openings))
            for i, opening in enumerate(closed.openings):
                names.append(f"{short}_opening_{i + 1}")
                points.append(vertices[opening])
        return tuple(names), np.array(points)

    def _wide_box(self) -> FloatArray:
        return np.asarray(self.box_mm + np.array([[-MARGIN_MM], [MARGIN_MM]]))


def surface_anatomy(
    surfaces: Mapping[str, SurfaceSeries],
    *,
    mismatch_mm: float,
    seed: int,
    surgery: SurgicalChange = UNTOUCHED,
) -> SurfaceAnatomy:
    """Build a beating anatomy from real surfaces in frame "mr" with corresponding vertices.

    Args:
        surfaces: EPICARDIAL (required), LV_ENDOCARDIAL, RV_ENDOCARDIAL (optional); open ones are closed.
        mismatch_mm: RMS over the heart box of the smooth non-rigid difference to these surfaces.
        seed: seed of the mismatch.
        surgery: change of shape by surgery, drawn with the mismatch.
    Raises:
        InvalidInputError: no epicardium, other frame, differing phase times, or a surface that cannot close.
    """
    if EPICARDIAL not in surfaces:
        raise InvalidInputError(f"surfaces are {', '.join(surfaces) or 'none'}; needed at least {EPICARDIAL}")
    series = tuple(surfaces[name] for name in (EPICARDIAL, LV, RV) if name in surfaces)
    timing = series[0].timing
    for one in series:
        if one.frame != "mr":
            raise InvalidInputError(f"surface {one.name} is in frame '{one.frame}'; needed frame 'mr'")
        if not np.array_equal(one.timing.fractions, timing.fractions):
            raise InvalidInputError(f"surface {one.name} has other phase times than {series[0].name}")
    closed = {one.name: closed_series(one) for one in series}
    volumes = [
        enclosed_volume_mm3(v, closed[series[min(1, len(series) - 1)].name].triangles)
        for v in closed[series[min(1, len(series) - 1)].name].vertices_mm
    ]
    while closed[EPICARDIAL].vertices_mm.shape[1] < MIN_VERTICES:
        closed[EPICARDIAL] = refined(closed[EPICARDIAL])
    splines = {name: periodic_spline(timing, c.vertices_mm) for name, c in closed.items()}
    vertices = splines[EPICARDIAL](0.0)
    box = np.array([vertices.min(axis=0), vertices.max(axis=0)])
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x5E7F]))
    drawn = surgical_field(vertices, surgery, child_rng(seed, "surgery"))
    field = random_mismatch(box, mismatch_mm, rng, surgery=drawn)
    es_fraction = float(timing.fractions[int(np.argmin(volumes))])
    return SurfaceAnatomy(series, closed, splines, field, es_fraction)


def _apex(vertices: FloatArray, openings: IntArray) -> FloatArray:
    """Find the vertex farthest from the openings, or the lowest one of a surface without openings."""
    if len(openings) == 0:
        return np.asarray(vertices[vertices[:, 2].argmin()])
    center = vertices[openings].mean(axis=0)
    return np.asarray(vertices[((vertices - center) ** 2).sum(axis=1).argmax()])


def _spread_vertices(vertices: FloatArray, count: int) -> FloatArray:
    """Sample vertices by farthest points, starting at the first."""
    chosen = [0]
    nearest = ((vertices - vertices[0]) ** 2).sum(axis=1)
    for _ in range(count - 1):
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, ((vertices - vertices[chosen[-1]]) ** 2).sum(axis=1))
    return np.asarray(vertices[chosen])
