"""Heart at end-diastole from one real cine, turned into tissue for the simulation of ultrasound.

The MR of such a pair is the real image, untouched. Tissue between its slices is drawn by shape-based
interpolation (Raya and Udupa 1990) of nested grey-level sets, not of grey levels. Tissue classes are
quantiles of grey level; a random table, not monotone, gives each its acoustics, differently in each of
three regions whose borders no MR shows. Two neighbouring classes sound the same: MR shows a border that
ultrasound does not. Vessels, spots and a reflecting sheet are in the ultrasound alone.
"""

import numpy as np
from scipy import ndimage

from data_synth.seeds import child_rng
from dvf_ig.core import AnyArray, FloatArray, Grid, Volume

from .fields import smooth_field
from .organ import Acoustics, OrganLabels

VOXEL_MM = 0.8
HALF_EXTENT_MM = 58.0
BEYOND_MM = 8.0
"""Extent of the outermost slices' tissue beyond them."""
QUANTILES = (0.12, 0.28, 0.45, 0.6, 0.75, 0.9)
CLASSES = len(QUANTILES) + 1
REGIONS = 3
VESSEL, SPOT, SHEET = range(REGIONS * CLASSES, REGIONS * CLASSES + 3)
"""Labels of structures that ultrasound alone shows."""


def heart_labels(mr: Volume, depth_mm: float, seed: int) -> OrganLabels:
    """Label tissue around the middle of a stack of slices, frame "moving".

    Args:
        mr: real grey levels; slices along the last axis.
        depth_mm: imaging depth of the probe, with the heart in its middle.
    """
    rng = child_rng(seed, "organ anatomy")
    middle_mm = mr.grid.to_mm((np.array(mr.grid.shape) - 1) / 2.0)
    grid = _fine_grid(mr, middle_mm)
    labels = _classes(mr, grid) + CLASSES * _regions(grid, rng)
    across_slices = mr.grid.direction[:, 2]
    angle = rng.uniform(0, 2 * np.pi)
    inward = mr.grid.direction[:, :2] @ [np.cos(angle), np.sin(angle)] + 0.15 * rng.normal() * across_slices
    inward /= np.linalg.norm(inward)
    across = np.cross(inward, across_slices)
    shift_mm = mr.grid.direction[:, :2] @ rng.uniform(-8, 8, 2)
    _ultrasound_alone(labels, grid, middle_mm, rng)
    entry_mm = middle_mm + shift_mm - 0.55 * depth_mm * inward
    across /= np.linalg.norm(across)
    return OrganLabels(grid, labels, _acoustics(rng), entry_mm, inward, across)


def _fine_grid(mr: Volume, middle_mm: FloatArray) -> Grid:
    """Build a fine grid along the axes of the slices over their extent."""
    extent_mm = np.array(mr.grid.shape) * mr.grid.spacing_mm / 2.0
    half_mm = np.minimum(extent_mm, HALF_EXTENT_MM)
    half_mm[2] = min((mr.grid.shape[2] - 1) * mr.grid.spacing_mm[2] / 2.0 + BEYOND_MM, HALF_EXTENT_MM)
    count = (2 * half_mm / VOXEL_MM).astype(int)
    origin = middle_mm - mr.grid.direction @ (VOXEL_MM * (count - 1) / 2.0)
    shape = (int(count[0]), int(count[1]), int(count[2]))
    return Grid("moving", shape, origin, np.full(3, VOXEL_MM), mr.grid.direction)


def _classes(mr: Volume, grid: Grid) -> AnyArray:
    """Count (nx, ny, nz) the thresholds that the grey level exceeds, with interpolated outlines."""
    slices = mr.grid.shape[2]
    corner = mr.grid.to_index(grid.origin_mm)[:2]
    step = VOXEL_MM / mr.grid.spacing_mm[:2]
    rows, columns = (corner[a] + step[a] * np.arange(grid.shape[a]) for a in (0, 1))
    at = np.stack(np.meshgrid(rows, columns, indexing="ij"))
    images = [
        ndimage.map_coordinates(mr.values[..., k].astype(np.float64), at, order=3, mode="nearest")
        for k in range(slices)
    ]
    place = mr.grid.to_index(grid.to_mm(np.outer(np.arange(grid.shape[2]), [0.0, 0.0, 1.0])))[:, 2]
    place = np.clip(place, 0, slices - 1)
    low = np.minimum(place.astype(int), slices - 2)
    share = place - low
    labels = np.zeros(grid.shape, dtype=np.uint8)
    for level in np.quantile(np.stack(images), QUANTILES):
        depth = np.stack([_signed_depth(image > level) for image in images], axis=-1)
        labels += (1 - share) * depth[..., low] + share * depth[..., low + 1] > 0
    return labels


def _signed_depth(inside: AnyArray) -> FloatArray:
    """Compute (nx, ny) distances to the outline in voxels, positive inside."""
    if inside.all() or not inside.any():
        return np.full(inside.shape, 1e3 if inside.all() else -1e3)
    return np.asarray(ndimage.distance_transform_edt(inside) - ndimage.distance_transform_edt(~inside))


def _regions(grid: Grid, rng: np.random.Generator) -> AnyArray:
    field = smooth_field(grid, rng.uniform(45.0, 80.0), rng)
    return np.digitize(field, [-0.6, 0.6]).astype(np.uint8)


def _ultrasound_alone(labels: AnyArray, grid: Grid, middle_mm: FloatArray, rng: np.random.Generator) -> None:
    spots = smooth_field(grid, rng.uniform(10.0, 18.0), rng) > rng.uniform(2.2, 3.0)
    labels[spots] = SPOT
    p = grid.centers_mm() - middle_mm
    for _ in range(int(rng.integers(3, 8))):
        along = rng.normal(size=3)
        along /= np.linalg.norm(along)
        q = p - rng.normal(0, 18.0, 3)
        s = q @ along
        away = np.linalg.norm(q - s[..., None] * along, axis=-1)
        labels[(away < rng.uniform(0.7, 1.8)) & (np.abs(s) < rng.uniform(10, 30))] = VESSEL
    normal = rng.normal(size=3)
    bend = 5.0 * smooth_field(grid, 60.0, rng)
    sheet_mm = p @ (normal / np.linalg.norm(normal)) + bend - rng.uniform(-20, 20)
    labels[np.abs(sheet_mm) < 0.6] = SHEET


def _acoustics(rng: np.random.Generator) -> Acoustics:
    echo_db = rng.permutation(np.linspace(-28.0, 2.0, CLASSES)) + rng.normal(0, 3.0, CLASSES)
    impedance = rng.uniform(1.54, 1.66, CLASSES)
    alike = int(rng.integers(CLASSES - 1))
    echo_db[alike + 1], impedance[alike + 1] = echo_db[alike], impedance[alike]
    echo = [echo_db + rng.normal(0, 5.0, CLASSES) for _ in range(REGIONS)]
    stiff = [impedance + rng.normal(0, 0.006) for _ in range(REGIONS)]
    loss = rng.uniform(0.03, 0.1, REGIONS * CLASSES)
    return Acoustics(
        tuple(float(v) for v in (*np.concatenate(echo), -26.0, 3.0, -2.0)),
        tuple(float(v) for v in (*np.concatenate(stiff), 1.58, 1.64, 1.68)),
        tuple(float(v) for v in (*loss, 0.02, 0.15, 0.2)),
    )
