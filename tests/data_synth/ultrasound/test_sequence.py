"""The simulator in the plane: what moves, what stays, what shadows, what options do, determinism."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.heart.tissue import ACOUSTICS, Tissue
from data_synth.realism.gates import FACING, OBLIQUE
from data_synth.realism.media import Medium, medium
from data_synth.ultrasound.probe import SectorProbe
from data_synth.ultrasound.sequence import simulate_frame, simulate_lines, simulate_sequence
from dvf_ig.core import FloatArray, FrameMismatchError, InvalidInputError, Rigid

PROBE = SectorProbe(noise_db=-140.0, tgc_db_per_cm_mhz=0.0)
MUSCLE = medium(Tissue.LV_MYOCARDIUM)
ALONG_X = Rigid("mr", "plane", np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), np.array([-60.0, 0, 0]))
"""A probe 60 mm before the border of a medium, looking straight at it."""


def lines_db(
    anatomy: Medium, probe: SectorProbe = PROBE, *, frame: int = 0, pose: Rigid = OBLIQUE, phase: float = 0.0
) -> FloatArray:
    out = simulate_lines(anatomy, probe, pose, np.full(probe.lines, phase), seed=3, frame=frame)
    return np.asarray(out, dtype=np.float64)


def correlation(a: FloatArray, b: FloatArray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def test_tissue_speckle_stays_and_blood_speckle_is_redrawn() -> None:
    tissue = [lines_db(MUSCLE, frame=f)[10:-10, 100:-10] for f in (0, 1)]
    blood = [lines_db(medium(Tissue.LV_BLOOD), frame=f)[10:-10, 100:-10] for f in (0, 1)]
    assert correlation(*tissue) > 0.99
    assert abs(correlation(*blood)) < 0.05


def test_tissue_speckle_moves_with_the_tissue() -> None:
    """A known axial shift moves the envelope along the middle line by the same number of samples."""
    samples = 6
    moving = medium(Tissue.LV_MYOCARDIUM, shift_mm=(0.0, samples * PROBE.step_mm, 0.0))
    middle = slice(PROBE.lines // 2 - 3, PROBE.lines // 2 + 3)
    before = lines_db(moving, pose=FACING)[middle, 150:400]
    after = lines_db(moving, pose=FACING, phase=0.5)[middle]
    assert correlation(before, after[:, 150 + samples : 400 + samples]) > 0.5
    assert abs(correlation(before, after[:, 150:400])) < 0.25


def test_sequence_is_bit_identical_at_any_thread_count() -> None:
    halves = medium(Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD)
    probe = replace(PROBE, persistence=0.4, elevation_planes=2, bands=2, haze_db=-10.0, lines=48)
    poses = [Rigid("mr", "plane", np.eye(3), np.array([0.0, 0.1 * i, 0.2 * i])) for i in range(5)]
    phases = np.linspace(0, 1, 5 * probe.lines).reshape(5, -1)
    one = simulate_sequence(halves, probe, poses, phases, seed=4, threads=1)
    two = simulate_sequence(halves, probe, poses, phases, seed=4, threads=2)
    assert np.array_equal(one, two)
    assert not np.array_equal(one, simulate_sequence(halves, probe, poses, phases, seed=5, threads=2))
    plain = replace(probe, persistence=0.0)
    alone = simulate_frame(halves, plain, poses[3], phases[3], seed=4, frame=3)
    assert np.array_equal(alone, simulate_sequence(halves, plain, poses, phases, seed=4)[3])


def test_persistence_averages_what_is_redrawn() -> None:
    """The variance of independent frames falls to (1 − w)/(1 + w) once the past has filled."""
    probe = replace(PROBE, lines=32, samples=256, top_db=-20.0, rows=160, columns=172, mm_per_px=(1.0, 1.0))
    probe = replace(probe, apex_px=(86.0, 3.0))
    phases = np.zeros((10, probe.lines))
    blood = medium(Tissue.LV_BLOOD)
    shown = {
        w: simulate_sequence(blood, replace(probe, persistence=w), [FACING] * 10, phases, seed=1)[-1]
        for w in (0.0, 0.5)
    }
    inside = probe.fan.mask(160, 172)
    spread = [shown[w][inside].astype(np.float64).var() for w in (0.5, 0.0)]
    assert spread[0] / spread[1] == pytest.approx(1 / 3, rel=0.25)


def test_compounded_bands_trade_length_for_smoothness() -> None:
    """n disjoint bands: SNR 1.91 √n, and a pulse n times as long."""
    probe = replace(PROBE, bands=3, lines=192)
    level = lines_db(MUSCLE, probe)[15:-15, 100:-10]
    envelope = 10 ** (level / 20)
    assert envelope.mean() / envelope.std() == pytest.approx(1.91 * np.sqrt(3), rel=0.06)
    assert probe.axial_fwhm_mm == pytest.approx(3 * PROBE.axial_fwhm_mm)


def test_haze_lies_near_the_probe_and_stands_still() -> None:
    hazy = replace(PROBE, haze_db=0.0, haze_mm=10.0)
    moving = medium(Tissue.LV_BLOOD)
    first, second = (lines_db(moving, hazy, frame=f, pose=FACING) for f in (0, 1))
    near, far = slice(8, 28), slice(350, 500)
    assert correlation(first[:, near], second[:, near]) > 0.9
    assert abs(correlation(first[:, far], second[:, far])) < 0.1
    depth = PROBE.depths_mm[near].mean()
    wanted = -8.686 * depth / 10.0
    assert 10 * np.log10(np.mean(10 ** (first[:, near] / 10))) == pytest.approx(wanted, abs=2.0)


def test_a_thicker_slice_blurs_a_border_beside_the_plane() -> None:
    halves = medium(Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD, axis=2)
    beside = Rigid("mr", "plane", np.eye(3), np.array([0.0, 0.0, 1.5]))
    thin, thick = (
        np.mean(10 ** (lines_db(halves, replace(PROBE, elevation_planes=n), pose=beside)[:, 250:300] / 10))
        for n in (1, 7)
    )
    assert 10 * np.log10(thick / thin) > 10.0


def test_image_shows_each_half_on_its_side_and_nothing_outside_the_fan() -> None:
    probe = SectorProbe(noise_db=-140.0)
    halves = medium(Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD)
    image = simulate_frame(halves, probe, FACING, np.zeros(probe.lines), seed=1, frame=0)
    inside = probe.fan.mask(probe.rows, probe.columns)
    assert not image[~inside].any()
    column = np.arange(probe.columns)[None, :] + np.zeros((probe.rows, 1))
    left, right = image[inside & (column < 150)].mean(), image[inside & (column > 193)].mean()
    assert left > right + 60


def test_pixels_map_to_the_plane() -> None:
    corner = PROBE.plane_from_image.apply_pixels(np.array([PROBE.apex_px, (271.5, 106.0)]))
    assert np.allclose(corner.xyz_mm, [[0, 0, 0], [50.0, 50.0, 0]])


def test_interfaces_are_bright_when_faced_and_fade_when_oblique() -> None:
    """Two bloods of different impedance: all that returns above blood is the interface."""
    border = medium(Tissue.LV_BLOOD, Tissue.LV_BLOOD)
    fields = np.array(border.reference.acoustics)
    fields[41:, ..., 0] += np.log(1.75 / 1.61)
    fields[40:42, ..., 4] = np.log(1.75 / 1.61)
    border = replace(border, reference=replace(border.reference, acoustics=fields))

    def peak_db(tilt_deg: float) -> float:
        turn = Rigid.from_rotation_vector((0.0, 0.0, np.deg2rad(tilt_deg)), np.zeros(3), "mr", "mr")
        level = lines_db(border, pose=turn @ ALONG_X)[PROBE.lines // 2 - 2 : PROBE.lines // 2 + 2]
        return float(level[:, 150:350].max())

    facing, tilted = peak_db(0.0), peak_db(55.0)
    assert facing > -24.0
    assert facing - tilted > 6.0


@pytest.mark.parametrize(("beyond", "dirty"), [(Tissue.LUNG, True), (Tissue.BONE, False)])
def test_shadow_and_reverberation_behind_a_total_reflector(beyond: Tissue, dirty: bool) -> None:
    wall = medium(Tissue.MEDIASTINUM, beyond, reflecting=True, absorbing=True)
    pose = Rigid("mr", "plane", ALONG_X.rotation, np.array([-40.0, 0, 0]))
    level = lines_db(wall, replace(PROBE, dirty_shadow_db=-30.0 if dirty else -140.0), pose=pose)
    middle = level[PROBE.lines // 2]
    sample = {d: int(d / PROBE.step_mm) for d in (20, 36, 40, 44, 50, 60, 76, 84, 90)}
    before = np.median(middle[sample[20] : sample[36]])
    assert middle[sample[36] : sample[44]].max() > before + 15
    assert np.median(middle[sample[50] : sample[60]]) < before - 12
    # the second trip comes from twice the depth: smaller by both reflections and the way
    again = middle[sample[76] : sample[84]].max()
    first = middle[sample[36] : sample[44]].max()
    z = [ACOUSTICS[t].impedance_mrayl for t in (Tissue.MEDIASTINUM, beyond)]
    reflected = abs(z[1] - z[0]) / (z[1] + z[0])
    way_db = 2 * 4.0 * PROBE.frequency_mhz * ACOUSTICS[Tissue.MEDIASTINUM].attenuation_db
    wanted = 20 * np.log10(PROBE.face_reflection * reflected) - way_db
    assert again - first == pytest.approx(wanted, abs=4.0)
    assert (np.median(middle[sample[50] : sample[60]]) - before > -60) == dirty


def test_bad_input_is_refused_in_one_sentence() -> None:
    with pytest.raises(InvalidInputError, match="one for each scan line"):
        simulate_frame(MUSCLE, PROBE, OBLIQUE, np.zeros(3), seed=1, frame=0)
    wrong = Rigid.identity("tracker", "plane")
    with pytest.raises(FrameMismatchError, match="image plane"):
        simulate_frame(MUSCLE, PROBE, wrong, np.zeros(PROBE.lines), seed=1, frame=0)
    with pytest.raises(InvalidInputError, match="half angle"):
        SectorProbe(half_angle_rad=3.0)
    with pytest.raises(InvalidInputError, match="elevation planes"):
        SectorProbe(elevation_planes=0)
    with pytest.raises(InvalidInputError, match="persistence"):
        SectorProbe(persistence=1.0)
