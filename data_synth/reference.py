"""The heart at end-diastole as grids: what MR and ultrasound look up after going back through the motion."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray

from .tissue import ACOUSTICS, BLOOD, Tissue, bssfp_signal

Layers = list[tuple[Tissue, FloatArray]]

CHANNELS = 5
"""Ultrasound channels: ln Z, α dB/cm/MHz, echo amplitude of tissue, of blood, and |∇ ln Z| per mm."""

_THREADS = 2


class ReferenceShapes(Protocol):
    """Implicit shapes at end-diastole, frame "mr"; depths in mm, positive inside."""

    base: Tissue

    def organ(self, xyz_mm: FloatArray) -> FloatArray:
        """(n,) depth below the epicardial surface."""
        ...

    def inside(self, xyz_mm: FloatArray, organ: FloatArray) -> Layers:
        """Parts of the heart, painted in order over `base`."""
        ...

    def inside_ultrasound_only(self, xyz_mm: FloatArray) -> Layers:
        """Parts that pre-operative images do not show, painted last."""
        ...

    def outside(self, xyz_mm: FloatArray, organ: FloatArray) -> Layers:
        """Neighbours of the heart, painted in order over MEDIASTINUM."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceMap:
    """Soft-edged tissue fields on one grid, frame "mr", end-diastole, before any mismatch.

    Attributes:
        origin_mm: (3,) first node.
        spacing_mm: node pitch.
        organ_mm: (nx, ny, nz) float32 depth below the epicardium.
        inner, outer: (nx, ny, nz) uint8 codes that hold where the organ depth is positive, or not.
        signal: (nx, ny, nz) float32 noise-free bSSFP signal.
        acoustics: (nx, ny, nz, CHANNELS) float32.
    """

    origin_mm: FloatArray
    spacing_mm: float
    organ_mm: NDArray[np.float32]
    inner: NDArray[np.uint8]
    outer: NDArray[np.uint8]
    signal: NDArray[np.float32]
    acoustics: NDArray[np.float32]


def tissue_at(shapes: ReferenceShapes, xyz_mm: FloatArray, *, ultrasound: bool = True) -> NDArray[np.uint8]:
    """(n,) exact tissue codes of reference points; with or without the parts only ultrasound sees."""
    organ = shapes.organ(xyz_mm)
    inner, outer = _codes(shapes, xyz_mm, organ)
    if ultrasound:
        for tissue, depth in shapes.inside_ultrasound_only(xyz_mm):
            inner[depth > 0] = tissue
    return np.where(organ > 0, inner, outer)


def build_reference(shapes: ReferenceShapes, box_mm: FloatArray, spacing_mm: float) -> ReferenceMap:
    """Sample `shapes` over `box_mm` (2, 3); edges are blended over about one node, so walls are not staircased."""
    size = np.ceil((box_mm[1] - box_mm[0]) / spacing_mm).astype(int) + 1
    shape = (int(size[0]), int(size[1]), int(size[2]))
    organ = np.empty(shape, dtype=np.float32)
    inner, outer = np.empty(shape, dtype=np.uint8), np.empty(shape, dtype=np.uint8)
    signal = np.empty(shape, dtype=np.float32)
    acoustics = np.empty((*shape, CHANNELS), dtype=np.float32)
    y = box_mm[0, 1] + spacing_mm * np.arange(shape[1])
    z = box_mm[0, 2] + spacing_mm * np.arange(shape[2])
    plane = np.stack(np.meshgrid(y, z, indexing="ij"), axis=-1).reshape(-1, 2)
    signals = np.array([[bssfp_signal(t)] for t in Tissue])
    properties = np.array([_acoustic_row(t) for t in Tissue])
    row_of = {tissue: i for i, tissue in enumerate(Tissue)}

    def fill(i: int) -> None:
        points = np.column_stack([np.full(len(plane), box_mm[0, 0] + spacing_mm * i), plane])
        depth = shapes.organ(points)
        inside, outside = shapes.inside(points, depth), shapes.outside(points, depth)
        extra = shapes.inside_ultrasound_only(points)
        codes = _codes(shapes, points, depth)
        organ[i] = depth.reshape(shape[1:])
        inner[i], outer[i] = codes[0].reshape(shape[1:]), codes[1].reshape(shape[1:])
        edge = 1.2 * spacing_mm
        share = np.clip(0.5 + depth / edge, 0, 1)[:, None]
        for table, layers, out in (
            (signals, inside, signal[i][..., None]),
            (properties, inside + extra, acoustics[i][..., : CHANNELS - 1]),
        ):
            within = _painted(table, row_of, shapes.base, layers, edge)
            beyond = _painted(table, row_of, Tissue.MEDIASTINUM, outside, edge)
            out[...] = (beyond + share * (within - beyond)).reshape(out.shape)

    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(fill, range(shape[0])))
    slope = np.gradient(acoustics[..., 0], spacing_mm)
    acoustics[..., CHANNELS - 1] = np.sqrt(slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2)
    return ReferenceMap(np.array(box_mm[0]), spacing_mm, organ, inner, outer, signal, acoustics)


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
    table: FloatArray, row_of: dict[Tissue, int], base: Tissue, layers: Layers, edge_mm: float
) -> FloatArray:
    """(n, channels) values of `table` painted layer over layer, each edge blended over `edge_mm`."""
    out = np.repeat(table[row_of[base]][None], len(layers[0][1]), axis=0)
    for tissue, depth in layers:
        touched = np.flatnonzero(depth > -0.5 * edge_mm)
        share = np.minimum(0.5 + depth[touched] / edge_mm, 1.0)[:, None]
        out[touched] += share * (table[row_of[tissue]] - out[touched])
    return out


def _acoustic_row(tissue: Tissue) -> list[float]:
    a = ACOUSTICS[tissue]
    amplitude = 10 ** (a.echo_db / 20)
    is_blood = tissue in BLOOD
    return [
        float(np.log(a.impedance_mrayl)),
        a.attenuation_db,
        0.0 if is_blood else amplitude,
        amplitude if is_blood else 0.0,
    ]
