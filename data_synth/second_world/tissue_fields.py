"""Tissue in and around a heart of the second world: fat, effusion, trabeculae, regional echo, labels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from data_synth.heart.reference import ReferenceMap
from data_synth.heart.tissue import Tissue
from data_synth.kernels import tissue_map
from data_synth.seeds import child_rng
from data_synth.threads import for_each
from dvf_ig.core import FloatArray, read_only_arrays

from .drawn import Drawn
from .properties import BLOODS, EFFUSION, MUSCLES, TRABECULA, property_table
from .random_fields import wide_noise
from .resting_heart import RestingHeart

SPACING_MM = 1.25
_REFLECTORS = (Tissue.LUNG, Tissue.BONE)
_NEIGHBOURS = (Tissue.LUNG, Tissue.LIVER, Tissue.BONE)
_TRABECULATED = (Tissue.LV_BLOOD, Tissue.RV_BLOOD)

Slab = tuple[FloatArray, NDArray[np.uint8], NDArray[np.uint8]]
"""Property rows, tissue codes and drawn labels of the points of one slab."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TissueFields:
    """Fields that MR, its labels and ultrasound look up at end-diastole.

    Attributes:
        reference: tissue, acoustics and MR signal.
        drawn_labels: (nx, ny, nz) uint8 codes inside the heart with the observer's bias.
        outer_bias_mm: distance outside the epicardium at which the observer draws it.
    """

    reference: ReferenceMap
    drawn_labels: NDArray[np.uint8]
    outer_bias_mm: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Patches:
    """Thickness in mm of varying layers, and the noise of trabeculae, on the grid's nodes."""

    fat: NDArray[np.float32]
    effusion: NDArray[np.float32]
    trabeculae: NDArray[np.float32]
    regional_db: NDArray[np.float32]


def tissue_fields(heart: RestingHeart, drawn: Drawn) -> TissueFields:
    """Sample the heart and its surroundings; edges are blended over about a node."""
    box = heart.wide_box_mm
    shape = tuple(int(n) for n in np.ceil((box[1] - box[0]) / SPACING_MM).astype(int) + 1)
    axes = [box[0, k] + SPACING_MM * np.arange(shape[k]) for k in range(3)]
    patches = _patches(shape, axes, heart, drawn)
    painter = _Painter(heart, drawn)
    organ = np.empty(shape, dtype=np.float32)
    inner, outer, labels = (np.zeros(shape, dtype=np.uint8) for _ in range(3))
    signal = np.empty(shape, dtype=np.float32)
    acoustics = np.empty((*shape, 5), dtype=np.float32)
    plane = np.stack(np.meshgrid(axes[1], axes[2], indexing="ij"), axis=-1).reshape(-1, 2)

    def fill(i: int) -> None:
        points = np.column_stack([np.full(len(plane), axes[0][i]), plane])
        depth = heart.shapes.organ(points)
        local = _Patches(*(part[i].reshape(-1) for part in (
            patches.fat, patches.effusion, patches.trabeculae, patches.regional_db)))  # fmt: skip
        rows, codes = painter.outside(points, depth, local)
        outer[i] = codes.reshape(shape[1:])
        near = depth > -4.0
        within, inner_codes, drawn_codes = painter.inside(points[near], depth[near], local, near)
        inner[i].reshape(-1)[near] = inner_codes
        labels[i].reshape(-1)[near] = drawn_codes
        share = np.clip(0.5 + depth[near] / painter.edge_mm, 0, 1)[:, None]
        rows[near] += share * (within - rows[near])
        organ[i] = depth.reshape(shape[1:])
        acoustics[i, ..., :4] = rows[:, :4].reshape(*shape[1:], 4)
        signal[i] = rows[:, 4].reshape(shape[1:])

    for_each(fill, range(shape[0]))
    tissue_map.gradient_norm(acoustics, 1.0 / SPACING_MM)
    fibres = wall_normals(np.isin(inner, MUSCLES) & (organ > 0), drawn["muscle.anisotropy_db"])
    reference = ReferenceMap(np.array(box[0]), SPACING_MM, organ, inner, outer, signal, acoustics, fibres)
    return TissueFields(reference, labels, drawn["labels.outer_bias_mm"])


def _patches(shape: tuple[int, ...], axes: list[FloatArray], heart: RestingHeart, drawn: Drawn) -> _Patches:
    def noise(length_mm: float, stream: str) -> NDArray[np.float32]:
        return wide_noise(shape, SPACING_MM, length_mm, child_rng(drawn.seed, f"second world {stream}"))

    patchy = 1.0 + 0.8 * noise(drawn["heart.fat_patch_mm"], "fat")
    fat = np.clip(drawn["heart.fat_mean_mm"] * patchy, 0.0, drawn["heart.fat_most_mm"])
    # fluid gathers behind and below in a lying patient
    center, half = heart.box_mm.mean(axis=0), 0.5 * np.ptp(heart.box_mm, axis=0)
    y, z = (axes[1] - center[1]) / half[1], (axes[2] - center[2]) / half[2]
    low = np.clip(0.4 + 0.5 * y[:, None] - 0.4 * z[None, :], 0.0, 1.0).astype(np.float32)
    effusion = max(drawn["heart.effusion_mm"], 0.0) * np.clip(
        low[None] * (1.0 + 0.3 * noise(30.0, "effusion")), 0.0, 1.0
    )
    share = drawn["heart.trabeculae_share"]
    width = drawn["heart.trabeculae_width_mm"]
    ridges = noise(width, "trabeculae")
    # a depth in mm, positive in the given share of space
    trabeculae = (ridges - np.quantile(ridges[::3, ::3, ::3], 1.0 - share)) * width
    regional = 0.5 * drawn["muscle.regional_db"] * noise(drawn["muscle.regional_length_mm"], "muscle")
    most = drawn["muscle.regional_db"]
    return _Patches(fat, effusion, trabeculae, np.clip(regional, -most, most))


class _Painter:
    """Painter of the layers of one heart."""

    def __init__(self, heart: RestingHeart, drawn: Drawn) -> None:
        self.shapes = heart.shapes
        self.table = property_table(drawn)
        self.edge_mm = 1.2 * SPACING_MM
        self.pericardium_mm = drawn["heart.pericardium_mm"]
        self.trabeculae_mm = drawn["heart.trabeculae_mm"]
        self.trabecula_mm = 2.0 * drawn["heart.trabeculae_width_mm"]
        self.blood_bias_mm = drawn["labels.blood_bias_mm"]
        self.outer_bias_mm = drawn["labels.outer_bias_mm"]

    def outside(
        self, points: FloatArray, depth: FloatArray, patches: _Patches
    ) -> tuple[FloatArray, NDArray[np.uint8]]:
        """Compute property rows and codes around the heart."""
        out = -depth
        sac = patches.fat + patches.effusion
        layers = [(int(t), d) for t, d in self.shapes.outside(points, depth) if t in _NEIGHBOURS]
        layers += [
            (int(Tissue.PERICARDIUM), np.minimum(out - sac, sac + self.pericardium_mm - out)),
            (EFFUSION, np.minimum(out - patches.fat, sac - out)),
            (int(Tissue.FAT), np.minimum(out, patches.fat - out)),
        ]
        rows, codes = self._ground(len(points), int(Tissue.MEDIASTINUM))
        for code, layer in layers:
            self._paint(rows, code, layer)
            codes[layer > 0] = code
        return rows, codes

    def inside(
        self, points: FloatArray, depth: FloatArray, patches: _Patches, kept: NDArray[np.bool_]
    ) -> Slab:
        """Compute property rows, codes and drawn labels inside the heart (and just outside of it)."""
        rows, codes = self._ground(len(points), int(self.shapes.base))
        labels = codes.copy()
        for tissue, layer in self.shapes.inside(points, depth):
            self._paint(rows, int(tissue), layer)
            codes[layer > 0] = tissue
            labels[layer + self._bias_mm(tissue) > 0] = tissue
            if tissue in _TRABECULATED:
                # ridges rise from the wall and taper into the blood
                taper = 1.5 * layer / self.trabeculae_mm - 0.5
                ridge = patches.trabeculae[kept] - self.trabecula_mm * np.maximum(taper, 0.0)
                self._paint(rows, TRABECULA, np.minimum(ridge, layer))
        for tissue, layer in self.shapes.inside_ultrasound_only(points):
            signal = rows[:, -1].copy()
            self._paint(rows, int(tissue), layer)
            if tissue == Tissue.VALVE:
                rows[:, -1] = signal  # thinner than a voxel: MR does not show it
            codes[layer > 0] = tissue
        rows[:, 2] *= 10 ** (patches.regional_db[kept] / 20)
        return rows, codes, labels

    def _bias_mm(self, tissue: Tissue) -> float:
        if tissue in BLOODS:
            return self.blood_bias_mm
        return self.outer_bias_mm if tissue == Tissue.LV_MYOCARDIUM else 0.0

    def _ground(self, count: int, code: int) -> tuple[FloatArray, NDArray[np.uint8]]:
        return np.repeat(self.table[code][None], count, axis=0), np.full(count, code, dtype=np.uint8)

    def _paint(self, rows: FloatArray, code: int, layer: FloatArray) -> None:
        wide_mm = self.edge_mm * (3.0 if code in _REFLECTORS else 1.0)
        touched = np.flatnonzero(layer > -0.5 * wide_mm)
        share = np.minimum(0.5 + layer[touched] / wide_mm, 1.0)[:, None]
        rows[touched] += share * (self.table[code] - rows[touched])


def wall_normals(muscle: NDArray[np.bool_], drop_db: float) -> NDArray[np.float32]:
    """Estimate wall normals on every second node, each as long as the square root of the drop along it.

    They point in the direction in which smoothed muscle changes most (structure tensor); zero elsewhere.

    Args:
        muscle: (nx, ny, nz).
        drop_db: loss of a beam along a wall compared with one across it.
    """
    soft = gaussian_filter(muscle[::2, ::2, ::2].astype(np.float32), 0.7)
    slope = np.gradient(soft)
    tensor = np.empty((*soft.shape, 3, 3), dtype=np.float32)
    for a in range(3):
        for b in range(a, 3):
            tensor[..., a, b] = tensor[..., b, a] = gaussian_filter(slope[a] * slope[b], 1.5)
    out = np.zeros((*soft.shape, 3), dtype=np.float32)
    near = soft > 0.05
    values, vectors = np.linalg.eigh(tensor[near])
    clear = 1.0 - values[:, 1] / np.maximum(values[:, 2], 1e-12)
    out[near] = np.sqrt(drop_db * np.clip(clear, 0, 1))[:, None] * vectors[..., 2]
    return out
