"""Static anatomy from any label volume, for the ultrasound simulator."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from data_synth.heart.fibre_orientation import fibre_orientation
from data_synth.heart.reference import CHANNELS, ReferenceMap
from data_synth.heart.tissue import ACOUSTICS, BLOOD, FIRST_OUTSIDE, Tissue
from data_synth.kernels import tissue_map
from dvf_ig.core import AnyArray, FloatArray, InvalidInputError, Volume

WHOLE_HEART: dict[int, Tissue] = {
    1: Tissue.LV_MYOCARDIUM,
    2: Tissue.LA_BLOOD,
    3: Tissue.LV_BLOOD,
    4: Tissue.RA_BLOOD,
    5: Tissue.RV_BLOOD,
    6: Tissue.AORTA,
    7: Tissue.PULMONARY_ARTERY,
}
"""Labels of whole-heart segmentations (HeartDeformNets order)."""

WALL_MM: dict[Tissue, tuple[Tissue, float]] = {
    Tissue.RV_BLOOD: (Tissue.RV_WALL, 3.5),
    Tissue.LA_BLOOD: (Tissue.ATRIAL_WALL, 2.0),
    Tissue.RA_BLOOD: (Tissue.ATRIAL_WALL, 2.0),
    Tissue.LAA_BLOOD: (Tissue.ATRIAL_WALL, 2.0),
    Tissue.AORTA: (Tissue.VESSEL_WALL, 2.0),
    Tissue.PULMONARY_ARTERY: (Tissue.VESSEL_WALL, 1.5),
}
"""Thickness of the wall around a labelled blood pool without another label."""

VALVES = (
    {Tissue.LA_BLOOD, Tissue.LV_BLOOD},
    {Tissue.LV_BLOOD, Tissue.AORTA},
    {Tissue.RA_BLOOD, Tissue.RV_BLOOD},
    {Tissue.RV_BLOOD, Tissue.PULMONARY_ARTERY},
)
"""Pools that meet at a valve; others that touch are separated by a wall."""

FAT_MM, PERICARDIUM_MM = 2.0, 1.0
MARGIN_MM = 25.0
_EDGE_NODES = 0.6
_SAME_MM = 0.75


@dataclass(frozen=True, slots=True)
class NoMotion:
    """Motion of a static anatomy."""

    def pull_back(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        return xyz_mm


@dataclass(frozen=True, slots=True, eq=False)
class LabelAnatomy:
    """Anatomy for the ultrasound simulator from labels; frame "mr"."""

    reference: ReferenceMap
    inverse_motion: NoMotion

    @property
    def center_mm(self) -> FloatArray:
        """Centre (3,) of the heart."""
        nodes = np.argwhere(self.reference.organ_mm > 0)
        return np.asarray(self.reference.origin_mm + self.reference.spacing_mm * nodes.mean(axis=0))


def label_anatomy(
    labels: Volume, tissues: Mapping[int, Tissue] | None = None, *, spacing_mm: float = 1.0
) -> LabelAnatomy:
    """Build tissue fields around the labelled structures: walls, valves, epicardial fat, pericardium.

    Args:
        labels: integer volume; 0 and labels not in `tissues` are background.
        tissues: tissue of each label; None is WHOLE_HEART.
        spacing_mm: node pitch of the fields, along patient axes.
    Raises:
        InvalidInputError: no voxel carries a mapped label, or the labels are not integers.
    """
    tissue_of = WHOLE_HEART if tissues is None else tissues
    codes, origin = _resampled(labels, tissue_of, spacing_mm)
    codes = _with_valves(codes, spacing_mm)
    codes, organ_mm = _with_walls(codes, spacing_mm)
    inner = np.where(organ_mm > 0, codes, Tissue.ATRIAL_WALL).astype(np.uint8)
    outer = np.where(organ_mm > 0, Tissue.MEDIASTINUM, codes).astype(np.uint8)
    fields = _acoustic_fields(codes, spacing_mm)
    no_signal = np.zeros(codes.shape, dtype=np.float32)
    fibres = fibre_orientation(codes, spacing_mm)
    return LabelAnatomy(
        ReferenceMap(origin, spacing_mm, organ_mm, inner, outer, no_signal, fields, fibres), NoMotion()
    )


def _resampled(
    labels: Volume, tissues: Mapping[int, Tissue], spacing_mm: float
) -> tuple[NDArray[np.uint8], FloatArray]:
    """Resample tissue codes by nearest neighbour to a grid along patient axes; also return its origin."""
    box = _occupied(labels.values)
    values = np.asarray(labels.values)[box]
    if not np.issubdtype(values.dtype, np.integer) and not np.array_equal(values, np.rint(values)):
        raise InvalidInputError("the label volume holds fractions; needed whole numbers, one for each tissue")
    codes = np.zeros(values.shape, dtype=np.uint8)
    for label, tissue in tissues.items():
        codes[values == label] = tissue
    if not codes.any():
        raise InvalidInputError(
            f"no voxel carries one of the labels {sorted(tissues)}; name the tissues of this volume's labels"
        )
    low = np.array([part.start for part in box])
    shape: NDArray[np.int64] = np.array(codes.shape)
    high = low + shape - 1
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    points = labels.grid.to_mm(corners.astype(np.float64))
    origin = points.min(axis=0) - MARGIN_MM
    count = np.ceil((points.max(axis=0) + MARGIN_MM - origin) / spacing_mm).astype(int) + 1
    out: NDArray[np.uint8] = np.zeros(tuple(count), dtype=np.uint8)
    axes = [origin[k] + spacing_mm * np.arange(count[k]) for k in range(3)]
    for i, x in enumerate(axes[0]):
        xyz = np.stack(np.meshgrid(x, axes[1], axes[2], indexing="ij"), axis=-1)[0]
        index = np.rint(labels.grid.to_index(xyz)).astype(int) - low
        inside = ((index >= 0) & (index < shape)).all(axis=-1)
        index = np.clip(index, 0, shape - 1)
        out[i] = np.where(inside, codes[index[..., 0], index[..., 1], index[..., 2]], 0)
    return out, origin


def _occupied(values: AnyArray) -> tuple[slice, slice, slice]:
    """Find the box of the voxels that are not 0; all of an empty volume."""
    filled = values != 0
    spans = []
    for axis in range(3):
        filled_at = np.flatnonzero(filled.any(axis=tuple(a for a in range(3) if a != axis)))
        spans.append(
            slice(int(filled_at[0]), int(filled_at[-1]) + 1)
            if len(filled_at)
            else slice(0, values.shape[axis])
        )
    return spans[0], spans[1], spans[2]


def _with_valves(codes: NDArray[np.uint8], spacing_mm: float) -> NDArray[np.uint8]:
    """Add a leaflet where two pools meet at a valve, and a wall where two others touch."""
    out = codes.copy()
    present = [t for t in BLOOD if (codes == t).any()]
    far = {t: _distance_mm(codes == t, spacing_mm, 2 * _SAME_MM + spacing_mm) for t in present}
    for i, a in enumerate(present):
        for b in present[:i]:
            between = ((codes == a) & (far[b] <= _SAME_MM + 0.5 * spacing_mm)) | (
                (codes == b) & (far[a] <= _SAME_MM + 0.5 * spacing_mm)
            )
            out[between] = Tissue.VALVE if {a, b} in VALVES else Tissue.ATRIAL_WALL
    return out


def _with_walls(codes: NDArray[np.uint8], spacing_mm: float) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Add thin walls around bare blood, then fat and pericardium; also return depth below the epicardium."""
    out = codes.copy()
    bare = codes == 0
    for pool, (wall, thickness_mm) in WALL_MM.items():
        if (codes == pool).any():
            out[bare & (_distance_mm(codes == pool, spacing_mm, thickness_mm) <= thickness_mm)] = wall
    organ = (out > 0) & (out < FIRST_OUTSIDE)
    depth = distance_transform_edt(organ) - distance_transform_edt(~organ)
    organ_mm = (spacing_mm * (depth - 0.5 * np.sign(depth))).astype(np.float32)
    around = (out == 0) & (organ_mm > -(FAT_MM + PERICARDIUM_MM))
    out[around] = np.where(organ_mm[around] > -FAT_MM, Tissue.FAT, Tissue.PERICARDIUM)
    return out, organ_mm


def _acoustic_fields(codes: NDArray[np.uint8], spacing_mm: float) -> NDArray[np.float32]:
    """Compute (nx, ny, nz, CHANNELS) as in `ReferenceMap`, with edges softened over about a node."""
    fields = np.empty((*codes.shape, CHANNELS), dtype=np.float32)
    table = np.zeros((max(Tissue) + 1, CHANNELS - 1), dtype=np.float32)
    for tissue, a in ACOUSTICS.items():
        level = 10 ** (a.echo_db / 20)
        scatter = (0.0, level) if tissue in BLOOD else (level, 0.0)
        table[tissue] = (np.log(a.impedance_mrayl), a.attenuation_db, *scatter)
    for channel in range(CHANNELS - 1):
        fields[..., channel] = gaussian_filter(table[codes, channel], _EDGE_NODES)
    tissue_map.gradient_norm(fields, 1.0 / spacing_mm)
    return fields


def _distance_mm(pool: NDArray[np.bool_], spacing_mm: float, reach_mm: float) -> NDArray[np.float32]:
    """Compute the distance to a pool; infinite outside the box around all within `reach_mm`."""
    out = np.full(pool.shape, np.inf, dtype=np.float32)
    margin = int(np.ceil(reach_mm / spacing_mm)) + 1
    box = tuple(slice(max(0, part.start - margin), part.stop + margin) for part in _occupied(pool))
    out[box] = spacing_mm * distance_transform_edt(~pool[box])
    return out
