"""MR images of labelled tissue: three contrasts, each on its own grid."""

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray, Grid, Volume

from .brain import HALF_EXTENT_MM
from .fields import sampled, smooth_field
from .organ import OrganLabels

CONTRASTS = ("t1", "flair", "t2")
LEVELS = {
    # outside white cortex ventricle sulcus tumour rim oedema nucleus falx vessel plexus lesion clot
    "t1": (10, 112, 80, 28, 34, 74, 96, 88, 92, 60, 45, 70, 92, 110),
    "flair": (10, 66, 88, 16, 26, 122, 132, 138, 84, 40, 30, 60, 130, 68),
    "t2": (8, 60, 82, 150, 135, 112, 100, 104, 66, 25, 15, 105, 100, 62),
}
"""Typical grey levels of each contrast, in the order of the tissues of `brain`; every pair varies them."""


def mr_images(organ: OrganLabels, seed: int) -> dict[str, Volume]:
    """Simulate images by contrast, on different grids, frame "moving"."""
    return {name: _image(organ, seed, name) for name in CONTRASTS}


def _image(organ: OrganLabels, seed: int, name: str) -> Volume:
    rng = child_rng(seed, f"organ {name}")
    typical = np.array(LEVELS[name], dtype=np.float64)
    level = (typical + rng.normal(0, 7.0, len(typical)).clip(-14, 14)).clip(3)[organ.labels]
    level *= 1 + 0.04 * smooth_field(organ.grid, 9.0, rng)
    direction = Rotation.from_rotvec(rng.normal(0, 0.2, 3)).as_matrix()
    spacing = np.array([1.0, 1.0, rng.choice([1.0, 1.3, 2.0] if name == "flair" else [1.0, 1.0, 1.3])])
    middle = organ.grid.to_mm((np.array(organ.grid.shape) - 1) / 2.0)
    count = np.floor(2 * (HALF_EXTENT_MM - 4.0) / spacing).astype(int)
    origin = middle - direction @ (spacing * (count - 1) / 2)
    grid = Grid("moving", (int(count[0]), int(count[1]), int(count[2])), origin, spacing, direction)
    blurred = ndimage.gaussian_filter(level, 0.45 * spacing / organ.grid.spacing_mm)
    clean = sampled(blurred, organ.grid, grid.centers_mm())
    clean *= 1 + 0.12 * smooth_field(grid, 160.0, rng)
    noise = rng.uniform(2.0, 6.0)
    return Volume(grid, np.rint(_rician(clean, noise, rng)).astype(np.int16))


def _rician(clean: FloatArray, noise: float, rng: np.random.Generator) -> FloatArray:
    real, imaginary = (rng.normal(0, noise, clean.shape) for _ in range(2))
    return np.asarray(np.hypot(clean + real, imaginary))
