"""The sector simulator: speckle statistics, contrast, attenuation, point spread, determinism."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from data_synth.kernels import sector
from data_synth.motion import InverseMotion
from data_synth.reference import CHANNELS, ReferenceMap
from data_synth.tissue import ACOUSTICS, Tissue
from data_synth.ultrasound import simulate_frame, simulate_lines, simulate_sequence
from data_synth.ultrasound_probe import SectorProbe
from dvf_ig.core import FloatArray, FrameMismatchError, InvalidInputError, Rigid

PLANE = Rigid.identity("mr", "plane")
OBLIQUE = Rigid.from_rotation_vector((0.4, -0.7, 0.5), np.zeros(3), "mr", "plane")
PROBE = SectorProbe(noise_db=-140.0)


@dataclass(frozen=True)
class Slab:
    """Homogeneous tissue, or two halves that meet at x = 0."""

    reference: ReferenceMap
    inverse_motion: InverseMotion


def row(tissue: Tissue, *, absorbing: bool) -> list[float]:
    a = ACOUSTICS[tissue]
    level = 10 ** (a.echo_db / 20)
    blood = tissue == Tissue.LV_BLOOD
    alpha = a.attenuation_db if absorbing else 0.0
    return [0.5, alpha, 0.0 if blood else level, level if blood else 0.0, 0.0]


def slab(left: Tissue, right: Tissue, *, absorbing: bool = False, shift_mm: float = 0.0) -> Slab:
    acoustics = np.empty((81, 5, 5, CHANNELS), dtype=np.float32)
    acoustics[:40] = row(left, absorbing=absorbing)
    acoustics[40:] = row(right, absorbing=absorbing)
    origin = np.array([-80.0, -400.0, -400.0])
    zeros = np.zeros((81, 5, 5), dtype=np.float32)
    codes = np.zeros((81, 5, 5), dtype=np.uint8)
    reference = ReferenceMap(origin, 2.0, zeros, codes, codes, zeros, acoustics)
    still = np.zeros((2, 2, 2, 2, 3), dtype=np.float32)
    still[..., 1] = -shift_mm
    return Slab(reference, InverseMotion(still, np.full(3, -500.0), 1000.0, None))


def lines_db(
    anatomy: Slab, probe: SectorProbe = PROBE, *, frame: int = 0, seed: int = 3, pose: Rigid = OBLIQUE
) -> FloatArray:
    phases = np.zeros(probe.lines)
    out = simulate_lines(anatomy, probe, pose, phases, seed=seed, frame=frame)
    return np.asarray(out, dtype=np.float64)


def flat_speckle(tissue: Tissue, frame: int = 0, seed: int = 3) -> FloatArray:
    """dB without time-gain compensation, well inside the sector and beyond the near field."""
    probe = replace(PROBE, tgc_db_per_cm_mhz=0.0)
    return lines_db(slab(tissue, tissue), probe, frame=frame, seed=seed)[10:-10, 100:-10]


@pytest.mark.parametrize("tissue", [Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD])
def test_homogeneous_speckle_is_fully_developed(tissue: Tissue) -> None:
    level = np.concatenate([flat_speckle(tissue, frame=f, seed=f) for f in range(4)])
    envelope = 10 ** (level / 20)
    assert envelope.mean() / envelope.std() == pytest.approx(1.91, abs=0.05)
    assert level.std() == pytest.approx(5.57, abs=0.2)
    power = envelope**2
    assert power.mean() ** 2 / power.var() == pytest.approx(1.0, abs=0.05)


def test_blood_is_darker_than_myocardium_by_the_table() -> None:
    power = [np.mean(10 ** (flat_speckle(t) / 10)) for t in (Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD)]
    assert 10 * np.log10(power[0] / power[1]) == pytest.approx(27.0, abs=1.0)


def test_attenuation_slope_without_compensation() -> None:
    probe = replace(PROBE, tgc_db_per_cm_mhz=0.0)
    anatomy = slab(Tissue.LV_MYOCARDIUM, Tissue.LV_MYOCARDIUM, absorbing=True)
    power = np.mean([10 ** (lines_db(anatomy, probe, seed=s) / 10) for s in range(4)], axis=(0, 1))
    depth_cm = (np.arange(probe.samples) + 0.5) * probe.step_mm / 10
    deep = depth_cm > 3
    slope = np.polyfit(depth_cm[deep], 10 * np.log10(power[deep]), 1)[0]
    assert slope == pytest.approx(-2 * 0.52 * probe.frequency_mhz, rel=0.05)


def fwhm(profile: FloatArray, pitch: float) -> float:
    fine = np.interp(np.arange(0, len(profile), 0.01), np.arange(len(profile)), profile)
    return float((fine > 0.5 * fine.max()).sum() * 0.01 * pitch)


@pytest.mark.parametrize("depth_mm", [40.0, 80.0, 120.0])
def test_point_target_has_the_stated_width(depth_mm: float) -> None:
    probe = SectorProbe()
    sample = int(depth_mm / probe.step_mm)
    raster = (probe.lines * probe.fine_lines, 2 * probe.samples)
    point = np.zeros(raster, dtype=np.float32)
    point[raster[0] // 2, 2 * sample] = 1.0
    pulse = np.empty((raster[0], probe.samples), dtype=np.float32)
    beam = np.empty((probe.lines, probe.samples), dtype=np.float32)
    sector.axial_blur(point, probe.axial_taps(), pulse)
    sector.lateral_blur(pulse, probe.lateral_taps(), probe.fine_lines, beam)
    line, peak = np.unravel_index(beam.argmax(), beam.shape)
    pitch = 2 * probe.half_angle_rad / (probe.lines - 1) * depth_mm
    assert fwhm(beam[:, peak], pitch) == pytest.approx(float(probe.lateral_fwhm_mm(depth_mm)), rel=0.1)
    taps = probe.axial_taps().astype(np.float64)
    assert fwhm(taps, probe.step_mm / 2) == pytest.approx(probe.axial_fwhm_mm, rel=0.1)
    assert abs(line - probe.lines / 2) <= 1


def test_tissue_speckle_stays_and_blood_speckle_is_redrawn() -> None:
    def correlation(tissue: Tissue) -> float:
        first, second = flat_speckle(tissue, 0), flat_speckle(tissue, 1)
        return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])

    assert correlation(Tissue.LV_MYOCARDIUM) > 0.99
    assert abs(correlation(Tissue.LV_BLOOD)) < 0.05


def test_tissue_speckle_moves_with_the_tissue() -> None:
    """A known axial shift moves the envelope along the middle line by the same number of samples."""
    shift = 6
    level = replace(PROBE, tgc_db_per_cm_mhz=0.0)
    still = slab(Tissue.LV_MYOCARDIUM, Tissue.LV_MYOCARDIUM)
    moved = slab(Tissue.LV_MYOCARDIUM, Tissue.LV_MYOCARDIUM, shift_mm=shift * PROBE.step_mm)
    middle = slice(PROBE.lines // 2 - 3, PROBE.lines // 2 + 3)
    before, after = (
        lines_db(still, level, pose=PLANE)[middle, 150:400],
        lines_db(moved, level, pose=PLANE)[middle, 150 + shift : 400 + shift],
    )
    wrong = lines_db(moved, level, pose=PLANE)[middle, 150:400]
    aligned = float(np.corrcoef(before.ravel(), after.ravel())[0, 1])
    assert aligned > 0.5
    assert abs(float(np.corrcoef(before.ravel(), wrong.ravel())[0, 1])) < 0.25


def test_sequence_is_bit_identical_at_any_thread_count() -> None:
    anatomy = slab(Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD)
    poses = [Rigid("mr", "plane", np.eye(3), np.array([0.0, 0.1 * i, 0.2 * i])) for i in range(5)]
    phases = np.linspace(0, 1, 5 * PROBE.lines).reshape(5, -1)
    one = simulate_sequence(anatomy, PROBE, poses, phases, seed=4, threads=1)
    two = simulate_sequence(anatomy, PROBE, poses, phases, seed=4, threads=2)
    assert np.array_equal(one, two)
    single = simulate_frame(anatomy, PROBE, poses[3], phases[3], seed=4, frame=3)
    assert np.array_equal(single, one[3])
    assert not np.array_equal(one, simulate_sequence(anatomy, PROBE, poses, phases, seed=5, threads=2))


def test_image_shows_each_half_on_its_side_and_nothing_outside_the_fan() -> None:
    image = simulate_frame(
        slab(Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD), PROBE, PLANE, np.zeros(PROBE.lines), seed=1, frame=0
    )
    inside = PROBE.fan.mask(PROBE.rows, PROBE.columns)
    assert not image[~inside].any()
    column = np.arange(PROBE.columns)[None, :] + np.zeros((PROBE.rows, 1))
    left, right = image[inside & (column < 150)].mean(), image[inside & (column > 193)].mean()
    assert left > right + 60


def test_pixels_map_to_the_plane() -> None:
    corner = PROBE.plane_from_image.apply_pixels(np.array([PROBE.apex_px, (271.5, 106.0)]))
    assert np.allclose(corner.xyz_mm, [[0, 0, 0], [50.0, 50.0, 0]])


def test_shadow_behind_air() -> None:
    anatomy = slab(Tissue.LV_MYOCARDIUM, Tissue.LV_MYOCARDIUM)
    acoustics = np.array(anatomy.reference.acoustics)
    acoustics[40:, ..., 0] = np.log(0.0004)
    acoustics[40:, ..., 4] = 4.0
    air = Slab(replace(anatomy.reference, acoustics=acoustics), anatomy.inverse_motion)
    facing = Rigid("mr", "plane", np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), np.array([-60.0, 0, 0]))
    level = simulate_lines(air, PROBE, facing, np.zeros(PROBE.lines), seed=1, frame=0)
    middle = level[PROBE.lines // 2]
    border = int(59.0 / PROBE.step_mm)
    before, behind = middle[border - 60 : border - 10], middle[border + 20 : border + 80]
    assert middle[border - 10 : border + 10].max() > before.max()
    assert np.median(behind) < np.median(before) - 40


def test_bad_input_is_refused_in_one_sentence() -> None:
    anatomy = slab(Tissue.LV_BLOOD, Tissue.LV_BLOOD)
    with pytest.raises(InvalidInputError, match="one for each scan line"):
        simulate_frame(anatomy, PROBE, PLANE, np.zeros(3), seed=1, frame=0)
    wrong = Rigid.identity("tracker", "plane")
    with pytest.raises(FrameMismatchError, match="image plane"):
        simulate_frame(anatomy, PROBE, wrong, np.zeros(PROBE.lines), seed=1, frame=0)
    with pytest.raises(InvalidInputError, match="half angle"):
        SectorProbe(half_angle_rad=3.0)
