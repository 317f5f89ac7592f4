"""3-D ultrasound, and the geometry of curved and side-fire arrays."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.heart.tissue import Tissue
from data_synth.realism.gates import FACING, point_gates
from data_synth.realism.media import medium
from data_synth.ultrasound.presets import PROBES, probe_named
from data_synth.ultrasound.probe import SectorProbe
from data_synth.ultrasound.sequence import simulate_frame
from data_synth.ultrasound.volume import MatrixProbe, simulate_pyramid, simulate_volume
from dvf_ig.core import InvalidInputError, Rigid

SMALL = MatrixProbe(
    replace(MatrixProbe().sector, lines=32, samples=192, depth_mm=90.0, noise_db=-140.0), tall=32
)
PHASES = np.zeros((32, 32))


@pytest.mark.parametrize("axis", [0, 2])
def test_a_border_stands_where_it_is(axis: int) -> None:
    """Myocardium below, blood above 0 along the lateral or the elevation axis."""
    halves = medium(Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD, axis=axis)
    made = simulate_volume(halves, SMALL, FACING, PHASES, seed=1)
    image = np.moveaxis(made.image.values, axis, 0).astype(float)
    seen = np.moveaxis(made.mask.values, axis, 0) > 0
    grid = made.image.grid
    place = grid.origin_mm[axis] + grid.spacing_mm[axis] * np.arange(len(image))
    bright = [image[i][seen[i]].mean() if seen[i].any() else 0.0 for i in range(len(image))]
    left, right = np.interp(-12.0, place, bright), np.interp(12.0, place, bright)
    assert left > right + 60
    middle = 0.5 * (left + right)
    inner = np.abs(place) < 12.0
    crossing = np.interp(-middle, -np.array(bright)[inner], place[inner])
    assert abs(crossing) < 3.5  # compression pushes it towards the blood, by less than a beam


def test_mask_is_the_pyramid() -> None:
    made = simulate_volume(medium(Tissue.LV_MYOCARDIUM), SMALL, FACING, PHASES, seed=1)
    xyz = made.mask.grid.centers_mm()
    half = SMALL.sector.half_angle_rad
    inside = (np.abs(np.arctan2(xyz[..., 0], xyz[..., 1])) <= half) & (
        np.abs(np.arctan2(xyz[..., 2], xyz[..., 1])) <= half
    )
    inside &= np.linalg.norm(xyz, axis=-1) <= SMALL.sector.depth_mm
    assert (inside != (made.mask.values > 0)).mean() < 2e-3
    assert not made.image.values[made.mask.values == 0].any()
    assert made.image.grid.frame == "plane"


def test_volume_speckle_is_fully_developed() -> None:
    probe = MatrixProbe(replace(SMALL.sector, tgc_db_per_cm_mhz=0.0), 32)
    level = simulate_pyramid(medium(Tissue.LV_MYOCARDIUM), probe, FACING, PHASES, seed=2)
    envelope = 10 ** (level[3:-3, 3:-3, 40:-5].astype(np.float64) / 20)
    assert 10 * np.log10(np.mean(envelope**2)) == pytest.approx(0.0, abs=0.5)
    assert envelope.mean() / envelope.std() == pytest.approx(1.91, abs=0.05)


def test_volume_is_bit_identical_at_any_thread_count() -> None:
    halves = medium(Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD)
    one, two = (simulate_volume(halves, SMALL, FACING, PHASES, seed=1, threads=n) for n in (1, 2))
    assert np.array_equal(one.image.values, two.image.values)


def test_curved_array_looks_from_its_face() -> None:
    """A border 60 mm below the face of a curved array stands at arc radius + 60 mm from the fan's apex."""
    probe = PROBES["curvilinear"]
    assert isinstance(probe, SectorProbe)
    halves = medium(Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD, axis=1)
    apex = Rigid("mr", "plane", np.eye(3), np.array([0.0, -probe.face_radius_mm - 60.0, 0.0]))
    image = simulate_frame(halves, probe, apex, np.zeros(probe.lines), seed=1, frame=0)
    column = round(probe.apex_px[0])
    profile = image[:, column - 10 : column + 10].mean(axis=1)
    row = probe.apex_px[1] + (probe.face_radius_mm + 60.0) / probe.mm_per_px[1]
    assert profile[int(row) - 40 : int(row) - 10].mean() > profile[int(row) + 10 : int(row) + 40].mean() + 60
    start = probe.apex_px[1] + probe.face_radius_mm / probe.mm_per_px[1]
    assert abs(np.flatnonzero(profile)[0] - start) <= 2
    assert all(gate.passed for gate in point_gates(probe))


def test_bad_probes_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="choose from epicardial"):
        probe_named("gamma camera")
    with pytest.raises(InvalidInputError, match="flat array"):
        MatrixProbe(replace(SMALL.sector, bands=2))
    with pytest.raises(InvalidInputError, match="one for each scan line"):
        simulate_volume(medium(Tissue.FAT), SMALL, FACING, np.zeros((3, 32)), seed=1)
