"""Lines of a flat wall or floor in images that are speckle and one bright line."""

import numpy as np
import pytest

from dvf_ig.calibration import find_wall_lines, wall_trace
from dvf_ig.core import FloatArray, QualityGateError


def tank(rows: FloatArray, slope: float, seed: int = 0) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Speckled images with an oblique bright floor and a bright scale that stands still."""
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 25, (len(rows), 200, 160)).astype(np.float64)
    r, c = np.mgrid[:200, :160]
    for i, row in enumerate(rows):
        images[i] += 180 * np.exp(-0.5 * ((r - row - slope * (c - 79.5)) / 2.0) ** 2) * (c > 20)
    images[:, 30:34, :] = 250
    return np.clip(images, 0, 255).astype(np.uint8)


def test_floor_is_found_to_a_fraction_of_a_pixel() -> None:
    rows = 100 + 40 * np.sin(np.arange(24) * 0.7)
    lines = find_wall_lines(tank(rows, 0.2), rng=np.random.default_rng(0))
    assert lines.is_found.all()
    # some 140 columns, each within half a pixel
    assert np.abs(lines.row_px - rows).max() < 0.5
    assert np.abs(lines.slope - 0.2).max() < 0.01


def test_images_without_a_floor_are_refused() -> None:
    speckle = np.random.default_rng(0).integers(0, 60, (20, 200, 160)).astype(np.uint8)
    with pytest.raises(QualityGateError, match="of 20 frames"):
        wall_trace(np.arange(20.0), speckle, np.ones(20, bool), rng=np.random.default_rng(0))
