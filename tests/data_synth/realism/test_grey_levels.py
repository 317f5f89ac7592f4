"""Grey levels of images: contrast, drop-out and speckle's size as they were made."""

import numpy as np
import pytest
from scipy import ndimage

from data_synth.realism.grey_levels import grey_levels

MM_PER_PX = (0.25, 0.5)


def speckled(sigma_px: tuple[float, float], deviation: float = 5.0) -> np.ndarray:
    """Six images of 50 x 70 mm with a margin that shows nothing: dark above, bright below, smooth noise."""
    noise = ndimage.gaussian_filter(np.random.default_rng(1).normal(size=(6, 200, 140)), (0, *sigma_px))
    level = np.where(np.arange(200) < 100, 60.0, 160.0)[:, None] + deviation * noise / noise.std()
    images = np.zeros((6, 220, 160), dtype=np.uint8)
    images[:, 10:210, 10:150] = level
    images[0, 110, 80] = 255
    return images


def test_level_contrast_and_deviation_are_those_of_the_image() -> None:
    found = grey_levels(speckled((1.0, 1.0)), MM_PER_PX)
    assert found.contrast == pytest.approx(100 * 100 / 255, abs=1.5)
    assert found.speckle == pytest.approx(100 * 5 / 255, rel=0.15)
    assert found.black == 0.0
    assert found.depth_slope > 0.0


def test_the_size_of_speckle_is_in_mm_along_each_axis() -> None:
    found = grey_levels(speckled((2.0, 1.0)), MM_PER_PX)
    half = 2.0 * np.sqrt(
        np.log(2.0)
    )  # of the correlation of noise smoothed by a Gaussian, in its sigmas; patches lower it
    assert found.axial_mm == pytest.approx(2.0 * half * 0.25, rel=0.2)
    assert found.lateral_mm == pytest.approx(1.0 * half * 0.5, rel=0.2)


def test_shadow_counts_as_black() -> None:
    images = speckled((1.0, 1.0))
    images[:3, 10:210, 60:100] = 1
    found = grey_levels(images, MM_PER_PX)
    assert 10.0 < found.black < 25.0
    assert found.gain > 5.0
