"""Labels of a brain under a craniotomy: cortex, ventricles, falx, deep nuclei, tumour, oedema, vessels.

Sulci are the zero crossings of a smooth random function, to a varying depth; cortex lines them. Structures
that MR or ultrasound alone shows (lesions of white matter, clots, a cyst's septa) has labels of its own.
"""

import numpy as np

from data_synth.seeds import child_rng
from dvf_ig.core import AnyArray, FloatArray, Grid

from .fields import smooth_field
from .organ import Acoustics, OrganLabels

(
    OUTSIDE, WHITE, CORTEX, VENTRICLE, SULCUS, TUMOUR, RIM,
    OEDEMA, NUCLEUS, FALX, VESSEL, PLEXUS, LESION, CLOT,
) = range(14)  # fmt: skip
VOXEL_MM = 0.8
HALF_EXTENT_MM = 64.0
SEMI_AXES_MM = np.array([62.0, 76.0, 54.0])


ECHO_DB = (-6, -14, -17, -36, 3, -5, -1, -12, -12, 6, -20, 4, -14, 4)
"""Acoustics of the tissues: sulci, falx, plexus and tumour are bright."""
IMPEDANCE = (1.60, 1.60, 1.585, 1.52, 1.63, 1.615, 1.63, 1.59, 1.595, 1.68, 1.56, 1.63, 1.60, 1.64)
LOSS_DB_PER_MM = (0.02, 0.07, 0.06, 0.005, 0.12, 0.09, 0.11, 0.06, 0.07, 0.35, 0.02, 0.12, 0.07, 0.20)
ACOUSTICS = Acoustics(ECHO_DB, IMPEDANCE, LOSS_DB_PER_MM)


def brain_labels(seed: int) -> OrganLabels:
    """Draw a brain and its craniotomy."""
    rng = child_rng(seed, "organ anatomy")
    outward = np.array([rng.uniform(-0.9, 0.9), rng.uniform(-0.7, 0.7), 1.0])
    outward /= np.linalg.norm(outward)
    axes_mm = SEMI_AXES_MM * rng.uniform(0.9, 1.1, 3)
    center_mm = np.array([14.0, -32.0, 51.0])
    entry_mm = center_mm + outward / np.linalg.norm(outward / axes_mm)
    middle_mm = entry_mm - 38.0 * outward
    count = int(2 * HALF_EXTENT_MM / VOXEL_MM)
    grid = Grid.axis_aligned("moving", (count,) * 3, middle_mm - HALF_EXTENT_MM, VOXEL_MM)
    p = (grid.centers_mm() - center_mm).astype(np.float32)
    depth_mm = (1.0 - np.linalg.norm(p / axes_mm, axis=-1)) * axes_mm.mean()
    depth_mm += 1.2 * smooth_field(grid, 40.0, rng)
    labels = _cortex(grid, depth_mm, rng)
    _deep_parts(labels, p, grid, depth_mm, rng)
    tumour_mm = middle_mm + rng.uniform(-0.7, 0.7, 3) * (18.0, 18.0, 14.0) - center_mm
    _tumour(labels, p - tumour_mm, grid, depth_mm, rng)
    _vessels(labels, p, depth_mm, rng, entry_mm - center_mm)
    _private(labels, grid, depth_mm, rng)
    labels[depth_mm < 0.0] = OUTSIDE
    return OrganLabels(grid, labels, ACOUSTICS, entry_mm, -outward)


def _cortex(grid: Grid, depth_mm: FloatArray, rng: np.random.Generator) -> AnyArray:
    fold = smooth_field(grid, rng.uniform(24.0, 38.0), rng) + 0.3 * smooth_field(grid, 14.0, rng)
    slope = np.sqrt(sum(np.square(np.gradient(fold, VOXEL_MM, axis=axis)) for axis in range(3)))
    away_mm = np.abs(fold) / np.maximum(slope, 0.25 * slope.mean())
    deep_mm = rng.uniform(14.0, 22.0) + 4.0 * smooth_field(grid, 40.0, rng)
    width_mm = rng.uniform(0.5, 1.0) * (1.0 + 0.3 * smooth_field(grid, 25.0, rng))
    thick_mm = rng.uniform(2.3, 3.2)
    labels = np.full(grid.shape, WHITE, dtype=np.uint8)
    labels[(depth_mm < thick_mm) | ((away_mm < thick_mm + width_mm) & (depth_mm < deep_mm + thick_mm))] = (
        CORTEX
    )
    labels[(away_mm < width_mm) & (depth_mm < deep_mm)] = SULCUS
    return labels


def _deep_parts(
    labels: AnyArray, p: FloatArray, grid: Grid, depth_mm: FloatArray, rng: np.random.Generator
) -> None:
    middle_mm = 2.0 * smooth_field(grid, 70.0, rng)
    for side in (-1.0, 1.0):
        x0, bend, width = side * rng.uniform(9, 14), side * rng.uniform(0.004, 0.01), rng.uniform(4, 8)
        z0, arch, half = rng.uniform(2, 12), rng.uniform(0.006, 0.012), rng.uniform(28, 38)
        y = p[..., 1] - rng.uniform(-6, 6)
        away = np.hypot(p[..., 0] - x0 - bend * y**2, (p[..., 2] - z0 + arch * y**2) / 1.3)
        radius = width * np.sqrt(np.clip(1 - (y / half) ** 2, 0, 1))
        nucleus = p - np.array([side * rng.uniform(20, 26), rng.uniform(-8, 8), rng.uniform(-6, 4)])
        labels[np.linalg.norm(nucleus / (7.0, 15.0, 9.0), axis=-1) < 1] = NUCLEUS
        labels[away < radius] = VENTRICLE
        labels[(away < 0.35 * radius) & (np.abs(y) < 0.6 * half)] = PLEXUS
    midline = np.abs(p[..., 0] - middle_mm)
    falx = (depth_mm < 32.0) & (p[..., 2] > 0)
    labels[(midline < 2.2) & falx & (labels != VENTRICLE)] = SULCUS
    labels[(midline < 0.8) & falx] = FALX


def _tumour(
    labels: AnyArray, q: FloatArray, grid: Grid, depth_mm: FloatArray, rng: np.random.Generator
) -> None:
    shape = np.linalg.norm(q / rng.uniform(0.8, 1.25, 3), axis=-1)
    radius = rng.uniform(8, 16) * (1 + 0.18 * smooth_field(grid, 26.0, rng))
    inside = (shape < radius) & (depth_mm > 2.0)
    swollen = (shape < radius + rng.uniform(0.0, 12.0) * (1 + 0.4 * smooth_field(grid, 30.0, rng))) & ~inside
    labels[swollen & (labels == WHITE)] = OEDEMA
    labels[inside] = TUMOUR
    labels[inside & (shape > radius - rng.uniform(1.0, 3.0))] = RIM
    if rng.random() < 0.5:  # a cyst in it
        labels[shape < radius * rng.uniform(0.3, 0.6)] = VENTRICLE


def _vessels(
    labels: AnyArray, p: FloatArray, depth_mm: FloatArray, rng: np.random.Generator, entry_mm: FloatArray
) -> None:
    """Draw bent tubes through the depth of the view."""
    for _ in range(int(rng.integers(5, 12))):
        begin = entry_mm * rng.uniform(0.1, 0.95) + rng.normal(0, 14.0, 3)
        along = rng.normal(size=3)
        along /= np.linalg.norm(along)
        bend = 0.01 * rng.normal(size=3)
        half, radius = rng.uniform(12, 35), rng.uniform(0.6, 1.5)
        # only the part of the grid that the tube can reach
        first = p[0, 0, 0]
        low = np.clip((begin - first - half - 12.0) / VOXEL_MM, 0, None).astype(int)
        high = np.clip((begin - first + half + 12.0) / VOXEL_MM, 0, None).astype(int) + 1
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        q = p[box] - begin.astype(np.float32)
        s = q @ along.astype(np.float32)
        q -= s[..., None] * along.astype(np.float32) + np.square(s)[..., None] * bend.astype(np.float32)
        tube = (np.square(q).sum(axis=-1) < radius**2) & (np.abs(s) < half) & (depth_mm[box] > 1.0)
        labels[box][tube] = VESSEL


def _private(labels: AnyArray, grid: Grid, depth_mm: FloatArray, rng: np.random.Generator) -> None:
    """Draw spots that one kind of image shows and the other does not."""
    for tissue, level in ((LESION, rng.uniform(2.3, 3.2)), (CLOT, rng.uniform(2.5, 3.4))):
        spots = smooth_field(grid, rng.uniform(12, 22), rng) > level
        labels[spots & (labels == WHITE) & (depth_mm > 6.0)] = tissue
