"""Gating: frames without anatomy are recognised at every brightness, and rejections counted by reason."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import BoolArray
from dvf_ig.kernels.grid.pool import block_sums
from dvf_ig.registration import FrameRejection, frame_information, gate_frames
from dvf_ig.registration.gating import FrameInformation

ROWS, COLUMNS = 240, 260
PITCH_MM = (0.5, 0.5)


def sector() -> BoolArray:
    row, column = np.mgrid[:ROWS, :COLUMNS]
    return np.asarray(np.hypot(row + 20.0, column - COLUMNS / 2) < ROWS)


def noise(seed: int, sigma_px: float, brightness: float, count: int = 6) -> NDArray[np.uint8]:
    """Rectified Gaussian noise, correlated over `sigma_px`."""
    raw = np.random.default_rng(seed).normal(size=(count, ROWS, COLUMNS))
    smooth = ndimage.gaussian_filter(raw, (0.0, sigma_px, sigma_px))
    return np.asarray(np.clip(brightness * np.abs(smooth) / smooth.std(), 0, 255), dtype=np.uint8)


def heart(seed: int, brightness: float, count: int = 6) -> NDArray[np.uint8]:
    """A dark chamber of 45 mm in speckled muscle, fading with depth."""
    row, column = np.mgrid[:ROWS, :COLUMNS]
    chamber = np.hypot(row - 120.0, column - 130.0) < 45.0
    level = np.where(chamber, 0.25, 1.0) * np.exp(-row / 300.0)
    speckle = noise(seed, 1.5, 60.0, count) / 60.0
    return np.asarray(np.clip(brightness * level * (0.3 + speckle), 0, 255), dtype=np.uint8)


def of(images: NDArray[np.uint8]) -> FrameInformation:
    return frame_information(images, sector(), PITCH_MM)


@pytest.mark.parametrize("brightness", [20.0, 80.0, 200.0])
def test_anatomy_in_speckle_is_kept_at_every_brightness(brightness: float) -> None:
    information = of(heart(1, brightness))
    assert not (information.dark | information.repeated | information.noise).any()


@pytest.mark.parametrize("brightness", [3.0, 40.0, 150.0])
@pytest.mark.parametrize("sigma_px", [0.0, 1.0, 3.0])
def test_noise_is_told_from_anatomy_whatever_its_grain_and_brightness(
    sigma_px: float, brightness: float
) -> None:
    assert of(noise(2, sigma_px, brightness)).noise.all()


def test_gain_that_falls_with_depth_is_not_anatomy() -> None:
    fading = noise(3, 1.0, 120.0) * np.exp(-np.arange(ROWS) / 150.0)[:, None]
    assert of(fading.astype(np.uint8)).noise.all()


def test_black_and_nearly_black_frames_are_dark_and_uniform_ones_noise() -> None:
    images = np.zeros((3, ROWS, COLUMNS), dtype=np.uint8)
    images[1] = noise(4, 0.0, 2.0)[0]
    images[2] = 90
    information = of(images)
    np.testing.assert_array_equal(information.dark, [True, True, False])
    assert information.noise.all()


def test_a_frame_is_frozen_where_its_sector_equals_that_of_the_frame_before() -> None:
    images = heart(5, 100.0, 4)
    images[2] = images[1]
    images[2][~sector()] = 255  # what is written beside the sector may change
    np.testing.assert_array_equal(of(images).repeated, [False, False, True, False])
    after = frame_information(images[2:], sector(), PITCH_MM, before=images[1])
    np.testing.assert_array_equal(after.repeated, [True, False])


def test_without_a_sector_every_frame_is_dark() -> None:
    nothing = np.zeros((ROWS, COLUMNS), dtype=bool)
    assert frame_information(heart(6, 100.0), nothing, PITCH_MM).dark.all()


def test_no_frames_give_no_information() -> None:
    assert len(of(np.zeros((0, ROWS, COLUMNS), dtype=np.uint8)).structure) == 0


def test_block_sums_are_those_of_numpy() -> None:
    images, mask = noise(7, 1.0, 60.0, 2), sector()
    sums, lit = np.empty((2, 30, 32), dtype=np.int64), np.empty(2, dtype=np.int64)
    block_sums(images, mask, 10, sums, lit)
    inside = np.where(mask, images, 0)[:, :, : 32 * 8].astype(np.int64)
    np.testing.assert_array_equal(sums, inside.reshape(2, 30, 8, 32, 8).sum(axis=(2, 4)))
    np.testing.assert_array_equal(lit, (inside > 10).sum(axis=(1, 2)))


def test_frames_without_information_are_counted_by_what_they_lack() -> None:
    good = np.ones(4, dtype=bool)
    gated = gate_frames(
        np.zeros(4),
        np.zeros(1),
        image_valid=good,
        pose_valid=good,
        beat_valid=good,
        information=FrameInformation(
            np.array([0.0, 0.9, 0.9, 0.9]),
            np.array([True, True, False, False]),
            np.array([0.0, 0.6, 0.1, 0.6]),
        ),
    )
    np.testing.assert_array_equal(gated.index, [3])
    for reason in (FrameRejection.DARK_IMAGE, FrameRejection.REPEATED_IMAGE, FrameRejection.NOISE_IMAGE):
        assert gated.rejected[reason] == 1


def test_gate_counts_each_reason_once() -> None:
    model_phase = np.array([0.00, 0.02, 0.50, 0.51, 0.53, 0.99, 0.0])
    good = np.ones(7, dtype=bool)
    tracked, resting = good.copy(), good.copy()
    tracked[1] = resting[1] = resting[6] = False
    gated = gate_frames(
        model_phase,
        np.array([0.0, 0.5]),
        image_valid=good,
        pose_valid=tracked,
        beat_valid=np.array([True, True, False, True, True, True, True]),
        information=FrameInformation(np.ones(7), np.zeros(7, dtype=bool), np.ones(7)),
        breath_valid=resting,
        window=0.02,
    )
    np.testing.assert_array_equal(gated.index, [0, 3, 5])
    assert gated.rejected == {
        "image marked invalid": 0,
        "image dark": 0,
        "image frozen": 0,
        "image without structure": 0,
        "probe not tracked": 1,
        "in the moving part of a breath, or before it is known": 1,
        "irregular or unfinished beat": 1,
        "between model phases": 1,
    }
