"""Clutter and shadows of 3-D ultrasound have the sizes that are stated."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.ultrasound.image_faults import CLUTTER_DB, CLUTTER_DECAY_MM, ImageSpec, degraded_pyramid
from data_synth.ultrasound.volume import MatrixProbe

ARRAY = MatrixProbe(sector=replace(MatrixProbe().sector, lines=24, samples=128), tall=24)
FLAT_DB = np.full((ARRAY.tall, ARRAY.sector.lines, ARRAY.sector.samples), -10.0, dtype=np.float32)


def test_pyramids_without_faults_are_untouched() -> None:
    assert degraded_pyramid(FLAT_DB, ARRAY, ImageSpec(), np.random.default_rng(0)) is FLAT_DB


@pytest.mark.parametrize("factor", [1.0, 5.0])
def test_clutter_adds_its_power_and_dies_out_with_depth(factor: float) -> None:
    dark = np.full_like(FLAT_DB, -200.0)
    out = degraded_pyramid(dark, ARRAY, ImageSpec(clutter=factor), np.random.default_rng(2))
    depth = ARRAY.sector.depths_mm
    for near, far in ((20.0, 40.0), (90.0, 110.0)):
        power = 10 ** (out[..., (depth > near) & (depth < far)].astype(np.float64) / 10)
        decay_db = 20 * np.log10(np.e) * 0.5 * (near + far) / CLUTTER_DECAY_MM
        assert 10 * np.log10(power.mean()) == pytest.approx(
            CLUTTER_DB + 20 * np.log10(factor) - decay_db, abs=0.7
        )
    over = degraded_pyramid(FLAT_DB, ARRAY, ImageSpec(clutter=factor), np.random.default_rng(2))
    added = 10 ** (over.astype(np.float64) / 10) - 10 ** (FLAT_DB.astype(np.float64) / 10)
    np.testing.assert_allclose(added, 10 ** (out.astype(np.float64) / 10), rtol=1e-2, atol=1e-5)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_shadow_takes_its_loss_from_its_cone_alone(seed: int) -> None:
    spec = ImageSpec(shadows=1, shadow_db=20.0)
    lost = FLAT_DB - degraded_pyramid(FLAT_DB, ARRAY, spec, np.random.default_rng(seed))
    assert lost.min() > -1e-4
    assert 15.0 < lost.max() < 20.0 + 1e-4, "lines 3° apart may miss its middle"
    deep = lost[..., ARRAY.sector.depths_mm > 60.0]
    assert np.ptp(deep, axis=2).max() < 0.01, "behind the onset all of a line loses alike"
    assert (deep[..., 0] < 1.0).mean() > 0.4, "the rest is left"
    near = lost[..., 0]
    assert near.max() < 0.5, "nothing at the face"
