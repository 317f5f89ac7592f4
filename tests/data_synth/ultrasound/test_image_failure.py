"""Images that stop showing the heart: from the stated moment on, and only then."""

import numpy as np
import pytest

from data_synth.ultrasound.image_failure import (
    NOISE_DB,
    ImageContent,
    ImageFailureSpec,
    noise_images,
    with_failure,
)
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import InvalidInputError

PROBE = SectorProbe(lines=64, samples=256, rows=160, columns=172, mm_per_px=(1.0, 1.0), apex_px=(85.5, 3.0))
T_S = np.arange(8) / 2.0
SECONDS = 4.0
HEART = np.tile(np.arange(10, 18, dtype=np.uint8)[:, None, None], (1, PROBE.rows, PROBE.columns))
FROM_HALF = slice(4, None)


def failing(spec: ImageFailureSpec) -> np.ndarray:
    return with_failure(HEART, PROBE, T_S, spec, SECONDS, np.random.default_rng(3))


def test_nothing_fails_by_default() -> None:
    assert failing(ImageFailureSpec()) is HEART
    assert failing(ImageFailureSpec(at_share=1.0, shows="black")) is HEART


@pytest.mark.parametrize("shows", ["noise", "black", "frozen"])
def test_images_before_the_failure_are_untouched(shows: ImageContent) -> None:
    spec = ImageFailureSpec(shows=shows)
    np.testing.assert_array_equal(failing(spec)[:4], HEART[:4])
    assert (HEART[:, 0, 0] == np.arange(10, 18)).all(), "the simulated images themselves stay"


def test_black_and_frozen_images() -> None:
    assert not failing(ImageFailureSpec(shows="black"))[FROM_HALF].any()
    assert (failing(ImageFailureSpec(shows="frozen"))[FROM_HALF] == HEART[3]).all()
    assert (failing(ImageFailureSpec(at_share=0.0, shows="frozen")) == HEART[0]).all()


def test_noise_is_weak_fills_the_sector_and_is_redrawn() -> None:
    shown = failing(ImageFailureSpec(shows="noise"))[FROM_HALF].astype(float)
    inside = PROBE.pixel_lookup()[0] >= 0
    assert not shown[:, ~inside].any()
    flat = shown[:, inside]
    # the mean of a Rayleigh-distributed envelope in dB lies 2.5 dB below its mean power
    grey = (NOISE_DB - 2.5 - PROBE.top_db + PROBE.dynamic_range_db) * 255.0 / PROBE.dynamic_range_db
    assert flat.mean() == pytest.approx(grey, abs=4.0)
    assert (flat.std(axis=1) > 8.0).all()
    between = np.corrcoef(flat) - np.eye(len(flat))
    assert np.abs(between).max() < 0.1


def test_noise_follows_its_generator() -> None:
    first, again, other = (noise_images(PROBE, 2, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("changes", [{"at_share": -0.1}, {"shows": "snow"}])
def test_impossible_failures_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError, match="needed"):
        ImageFailureSpec(**changes)
