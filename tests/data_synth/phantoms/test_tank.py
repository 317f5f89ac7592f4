"""Images of calibration phantoms show their features where the true geometry puts them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from data_synth.phantoms.crosswire import CrossWireSpec, crosswire_recording
from data_synth.phantoms.nwire import NWireSpec, nwire_images, nwire_recording, wire_crossings_px
from data_synth.phantoms.tank_image import Echoes, water_images
from data_synth.phantoms.wall import WallSpec, wall_recording
from data_synth.phantoms.watertank import WaterTankSpec, watertank_images, watertank_recording
from data_synth.scenario.ground_truth import draw_ground_truth
from data_synth.signals.tracker import TrackerSpec
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import FloatArray, InvalidInputError

PROBE = SectorProbe()
TRUTH = draw_ground_truth(np.zeros(3), PROBE.plane_from_image, 150.0, np.random.default_rng(4))
IMAGE = TRUTH.probe_from_image
EXACT = TrackerSpec(rate_hz=20.0, jitter_s=0.0, stamp_noise_s=0.0, position_mm=0.0, rotation_deg=0.0)
NOISELESS = {"point_noise_mm": 0.0, "failed_share": 0.0}
GREY_PER_DB = 255.0 / PROBE.dynamic_range_db


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def centroid_px(image: NDArray[np.uint8], around: FloatArray, reach: int = 8) -> FloatArray:
    """Power-weighted centroid (column, row) of what is bright near a pixel."""
    column, row = np.round(around).astype(int)
    part = image[row - reach : row + reach + 1, column - reach : column + reach + 1].astype(np.float64)
    power = np.where(part > 0, 10 ** (part / GREY_PER_DB / 10), 0.0)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    total = power.sum()
    return np.array([column + (power * columns).sum() / total, row + (power * rows).sum() / total])


def test_a_point_has_the_width_of_the_beam_and_the_pulse() -> None:
    depth = 60.0
    fine = replace(PROBE, mm_per_px=(0.1, 0.1), rows=700, columns=201, apex_px=(100.0, 5.0))
    echoes = Echoes(np.array([[0.0, depth, 0.0]]), np.array([0.3 + 0j]))
    image = water_images(fine, [echoes], 1)[0].astype(np.float64)
    amplitude = 10 ** (image / GREY_PER_DB / 20)
    for profile, fwhm in (
        (amplitude[605, :], float(PROBE.lateral_fwhm_mm(depth))),
        (amplitude[:, 100], PROBE.axial_fwhm_mm),
    ):
        width = np.count_nonzero(profile > 0.5 * profile.max()) * fine.mm_per_px[0]
        # interpolation between samples in decibels widens by up to half of one
        assert width == pytest.approx(fwhm, rel=0.08, abs=0.5 * PROBE.step_mm)
    assert np.unravel_index(image.argmax(), image.shape) == pytest.approx((605, 100), abs=2)


def test_nwire_images_are_of_the_recording_and_show_every_wire() -> None:
    spec = NWireSpec(frames=12, **NOISELESS)
    recording, sequence = nwire_images(IMAGE, PROBE, EXACT, spec, rng())
    plain = nwire_recording(IMAGE, PROBE.fan, (PROBE.columns, PROBE.rows), EXACT, spec, rng())
    np.testing.assert_array_equal(recording.points_px, plain.points_px)
    assert sequence.images is not None
    assert sequence.images.shape == (12, PROBE.rows, PROBE.columns)
    misses, contrasts = [], []
    for i, image in enumerate(sequence.images):
        pixels, _ = wire_crossings_px(
            recording.phantom, recording.phantom_from_probe.pose(i).matrix @ IMAGE.matrix
        )
        column, row = np.round(pixels).astype(int).T
        near = [image[r - 2 : r + 3, c - 3 : c + 4].max() for c, r in zip(column, row, strict=True)]
        contrasts.append(np.array(near, dtype=float))
        apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=2) + 1e3 * np.eye(9)
        misses += [centroid_px(image, p) - p for p in pixels[apart.min(axis=1) > 22]]
    assert np.mean(np.concatenate(contrasts) > 100) > 0.97
    # a rough wire through a thick beam: its centroid scatters by a fraction of the beam, without a bias
    error_mm = np.array(misses) * PROBE.mm_per_px[1]
    assert np.median(np.abs(error_mm), axis=0).max() < 0.6
    assert np.abs(np.median(error_mm, axis=0)).max() < 0.3


def test_every_crosswire_image_passes_through_the_crossing() -> None:
    spec = CrossWireSpec(frames=30, out_of_plane_mm=0.0, **NOISELESS)
    made = crosswire_recording(IMAGE, PROBE, EXACT, spec, rng())
    stream, images = made.recording.sequence.stream("tracker", "probe"), made.recording.sequence.images
    assert images is not None
    for i in range(30):
        seen = stream.pose(i).apply(IMAGE.apply_pixels(made.recording.features_px[i])).xyz_mm
        np.testing.assert_allclose(seen, made.crossing.xyz_mm, atol=1e-9)
        column, row = np.round(made.recording.exact_px[i, 0]).astype(int)
        assert images[i, row - 3 : row + 4, column - 3 : column + 4].max() > 100
    assert PROBE.fan.mask(PROBE.rows, PROBE.columns)[row, column]


def test_out_of_plane_error_is_as_stated() -> None:
    spec = CrossWireSpec(frames=150, out_of_plane_mm=0.5, **NOISELESS)
    made = crosswire_recording(IMAGE, PROBE, EXACT, spec, rng(3))
    stream = made.recording.sequence.stream("tracker", "probe")
    seen = [
        stream.pose(i).apply(IMAGE.apply_pixels(made.recording.exact_px[i])).xyz_mm[0] for i in range(150)
    ]
    off = np.linalg.norm(np.array(seen) - made.crossing.xyz_mm[0], axis=1)
    assert np.sqrt((off**2).mean()) == pytest.approx(0.5, rel=0.18)


def test_wall_lines_lie_on_the_wall_and_in_the_image() -> None:
    made = wall_recording(IMAGE, PROBE, EXACT, WallSpec(frames=20, **NOISELESS), rng())
    stream, images = made.recording.sequence.stream("tracker", "probe"), made.recording.sequence.images
    assert images is not None
    for i, image in enumerate(images):
        ends = made.recording.exact_px[i]
        seen = stream.pose(i).apply(IMAGE.apply_pixels(ends)).xyz_mm
        np.testing.assert_allclose(seen @ made.normal, made.offset_mm, atol=1e-9)
        middle = ends.mean(axis=0)
        column = round(float(middle[0]))
        brightest = int(image[:, column].argmax())
        assert image[brightest, column] > 80
        assert abs(brightest - middle[1]) * PROBE.mm_per_px[1] < 1.5


def test_watertank_images_show_the_floor_at_the_recorded_row() -> None:
    spec = WaterTankSpec(seconds=6.0, row_noise_mm=0.0)
    recording, video = watertank_images(IMAGE, PROBE, 0.05, EXACT, spec, rng(2))
    plain = watertank_recording(IMAGE, PROBE.fan, 0.05, EXACT, spec, rng(2))
    np.testing.assert_array_equal(recording.wall_row_px.values, plain.wall_row_px.values)
    np.testing.assert_array_equal(video.t_s, plain.wall_row_px.t_s)
    assert video.images is not None
    column = round(PROBE.apex_px[0])
    brightest = video.images[:, :, column].argmax(axis=1)
    assert np.abs(brightest - plain.wall_row_px.values).max() * PROBE.mm_per_px[1] < 1.0


def test_segmentation_noise_and_failures_are_as_stated() -> None:
    spec = WallSpec(frames=150, point_noise_mm=0.4, failed_share=0.1)
    made = wall_recording(IMAGE, PROBE, EXACT, spec, rng(5))
    error = (made.recording.features_px - made.recording.exact_px) * PROBE.mm_per_px[1]
    failed = np.isnan(error).all(axis=(1, 2))
    assert failed.mean() == pytest.approx(0.1, abs=0.075)
    assert np.nanstd(error) == pytest.approx(0.4, rel=0.09)


def test_impossible_sweeps_are_refused() -> None:
    with pytest.raises(InvalidInputError):
        CrossWireSpec(frames=0)
    with pytest.raises(InvalidInputError):
        WallSpec(tilt_deg=80.0)
