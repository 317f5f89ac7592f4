"""Heart at end-diastole as grids, which MR and ultrasound look up after undoing the motion."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_synth.kernels import tissue_map
from data_synth.threads import for_each
from dvf_ig.core import FloatArray, read_only_arrays

from .fibre_orientation import fibre_orientation
from .tissue import ACOUSTICS, BLOOD, Tissue, bssfp_signal

Layers = list[tuple[Tissue, FloatArray]]

CHANNELS = 5
"""Ultrasound channels: ln Z, α dB/cm/MHz, echo amplitude of tissue, of blood, and |∇ ln Z| per mm."""

REFLECTORS = (Tissue.LUNG, Tissue.BONE)
_REFLECTOR_EDGE = 3.0
"""Widening of edges: a tenth of them reflects all, and must not be a staircase of nodes."""


class ReferenceShapes(Protocol):
    """Implicit shapes at end-diastole, frame "mr"; depths in mm, positive inside."""

    @property
    def base(self) -> Tissue: ...

    def organ(self, xyz_mm: FloatArray) -> FloatArray:
        """Compute the (n,) depth below the epicardial surface."""

    def inside(self, xyz_mm: FloatArray, organ: FloatArray) -> Layers:
        """List parts of the heart, painted in order over `base`."""

    def inside_ultrasound_only(self, xyz_mm: FloatArray) -> Layers:
        """List parts that pre-operative images do not show, painted last."""

    def outside(self, xyz_mm: FloatArray, organ: FloatArray) -> Layers:
        """List neighbours of the heart, painted in order over MEDIASTINUM."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ReferenceMap:
    """Soft-edged tissue fields on one grid, frame "mr", end-diastole, before any mismatch.

    Attributes:
        origin_mm: (3,) first node.
        spacing_mm: node pitch.
        organ_mm: (nx, ny, nz) float32 depth below the epicardium.
        inner, outer: (nx, ny, nz) uint8 codes for positive organ depth, and for others.
        signal: (nx, ny, nz) float32 noise-free bSSFP signal.
        acoustics: (nx, ny, nz, CHANNELS) float32.
        fibre_orientation: wall normals on a coarser grid from the same origin, see the function of that name.
    """

    origin_mm: FloatArray
    spacing_mm: float
    organ_mm: NDArray[np.float32]
    inner: NDArray[np.uint8]
    outer: NDArray[np.uint8]
    signal: NDArray[np.float32]
    acoustics: NDArray[np.float32]
    fibre_orientation: NDArray[np.float32]

    def sample(self, xyz_mm: FloatArray, signal: NDArray[np.float32], codes: NDArray[np.uint8]) -> None:
        """Sample MR signal and tissue code at (n, 3) reference positions into `signal` and `codes` (n,)."""
        tissue_map.sample_mr(
            xyz_mm, self.organ_mm, self.inner, self.outer, self.signal, self.origin_mm,
            1.0 / self.spacing_mm, signal, codes,
        )  # fmt: skip


def tissue_at(shapes: ReferenceShapes, xyz_mm: FloatArray, *, ultrasound: bool = True) -> NDArray[np.uint8]:
    """Compute (n,) exact tissue codes of reference points, with or without ultrasound-only parts."""
    organ = shapes.organ(xyz_mm)
    inner, outer = _codes(shapes, xyz_mm, organ)
    if ultrasound:
        for tissue, depth in shapes.inside_ultrasound_only(xyz_mm):
            inner[depth > 0] = tissue
    return np.where(organ > 0, inner, outer)


def build_reference(shapes: ReferenceShapes, box_mm: FloatArray, spacing_mm: float) -> ReferenceMap:
    """Sample `shapes` over `box_mm` (2, 3); edges are blended over about a node, so walls are smooth."""
    size = np.ceil((box_mm[1] - box_mm[0]) / spacing_mm).astype(int) + 1
    shape = (int(size[0]), int(size[1]), int(size[2]))
    organ = np.empty(shape, dtype=np.float32)
    inner = np.full(shape, shapes.base, dtype=np.uint8)
    outer = np.full(shape, Tissue.MEDIASTINUM, dtype=np.uint8)
    signal = np.empty(shape, dtype=np.float32)
    acoustics = np.empty((*shape, CHANNELS), dtype=np.float32)
    y = box_mm[0, 1] + spacing_mm * np.arange(shape[1])
    z = box_mm[0, 2] + spacing_mm * np.arange(shape[2])
    plane = np.stack(np.meshgrid(y, z, indexing="ij"), axis=-1).reshape(-1, 2)
    edge = 1.2 * spacing_mm

    def fill(i: int) -> None:
        points = np.column_stack([np.full(len(plane), box_mm[0, 0] + spacing_mm * i), plane])
        depth = shapes.organ(points)
        organ[i] = depth.reshape(shape[1:])
        rows = np.empty((len(points), CHANNELS))
        out = depth < edge
        rows[out], codes = _painted(
            shapes.outside(points[out], depth[out]), Tissue.MEDIASTINUM, int(out.sum()), edge
        )
        outer[i].reshape(-1)[out] = codes
        near = depth > -max(edge, 2 * spacing_mm)
        within, codes = _painted(shapes.inside(points[near], depth[near]), shapes.base, int(near.sum()), edge)
        inner[i].reshape(-1)[near] = codes
        mr_only = within[:, -1].copy()
        _paint(within, codes, shapes.inside_ultrasound_only(points[near]), edge)
        within[:, -1] = mr_only
        share = np.clip(0.5 + depth[near] / edge, 0, 1)[:, None]
        rows[near] = np.where(share < 1, rows[near], 0) * (1 - share) + share * within
        acoustics[i, ..., : CHANNELS - 1] = rows[:, : CHANNELS - 1].reshape(*shape[1:], -1)
        signal[i] = rows[:, -1].reshape(shape[1:])

    for_each(fill, range(shape[0]))
    tissue_map.gradient_norm(acoustics, 1.0 / spacing_mm)
    fibres = fibre_orientation(np.where(organ > 0, inner, outer), spacing_mm)
    return ReferenceMap(np.array(box_mm[0]), spacing_mm, organ, inner, outer, signal, acoustics, fibres)


def _codes(
    shapes: ReferenceShapes, xyz_mm: FloatArray, organ: FloatArray
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    inner = np.full(len(xyz_mm), shapes.base, dtype=np.uint8)
    for tissue, depth in shapes.inside(xyz_mm, organ):
        inner[depth > 0] = tissue
    outer = np.full(len(xyz_mm), Tissue.MEDIASTINUM, dtype=np.uint8)
    for tissue, depth in shapes.outside(xyz_mm, organ):
        outer[depth > 0] = tissue
    return inner, outer


def _painted(
    layers: Layers, base: Tissue, count: int, edge_mm: float
) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Paint layers over `base`: (count, CHANNELS) property rows and (count,) codes."""
    rows = np.repeat(_PROPERTIES[int(base)][None], count, axis=0)
    codes = np.full(count, base, dtype=np.uint8)
    _paint(rows, codes, layers, edge_mm)
    return rows, codes


def _paint(rows: FloatArray, codes: NDArray[np.uint8], layers: Layers, edge_mm: float) -> None:
    """Paint layer over layer, each edge blended over `edge_mm`; codes change at depth 0."""
    for tissue, depth in layers:
        wide_mm = edge_mm * (_REFLECTOR_EDGE if tissue in REFLECTORS else 1.0)
        touched = np.flatnonzero(depth > -0.5 * wide_mm)
        if not len(touched):
            continue
        share = np.minimum(0.5 + depth[touched] / wide_mm, 1.0)[:, None]
        rows[touched] += share * (_PROPERTIES[int(tissue)] - rows[touched])
        codes[depth > 0] = tissue


def _property_row(tissue: Tissue) -> list[float]:
    """Return ln Z, α, echo of tissue, echo of blood, MR signal."""
    a = ACOUSTICS[tissue]
    amplitude = 10 ** (a.echo_db / 20)
    is_blood = tissue in BLOOD
    return [
        float(np.log(a.impedance_mrayl)),
        a.attenuation_db,
        0.0 if is_blood else amplitude,
        amplitude if is_blood else 0.0,
        bssfp_signal(tissue),
    ]


def _property_table() -> FloatArray:
    """Build (codes, CHANNELS) rows indexed by tissue code."""
    table = np.zeros((max(Tissue) + 1, CHANNELS))
    for tissue in Tissue:
        table[int(tissue)] = _property_row(tissue)
    return table


_PROPERTIES = _property_table()
