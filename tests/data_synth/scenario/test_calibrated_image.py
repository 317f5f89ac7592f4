"""A scenario with a real probe's calibration: its image, its pixels, its mounting; all else is as without."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth import CalibratedImage, ScenarioSpec, SectorProbe, phantom_scenario
from data_synth.ultrasound.scan_lines import beam_tables
from dvf_ig.core import ImageMap, InvalidInputError, NWireRecording, Rigid

TURN = Rotation.from_euler("xyz", [20, -35, 80], degrees=True).as_matrix()
FCAL = CalibratedImage(
    ImageMap(Rigid("probe", "image", TURN, np.array([11.2, 48.4, -0.4])), np.array([0.0803, 0.0745])),
    820,
    616,
)
"""The image of the fCal 2.0 sweep: 66 x 46 mm, pixels that are not square."""


def other(columns: int, rows: int, mm_per_px: tuple[float, float]) -> CalibratedImage:
    return CalibratedImage(ImageMap(FCAL.probe_from_image.rigid, np.array(mm_per_px)), columns, rows)


@pytest.mark.parametrize("image", [FCAL, other(400, 600, (0.2, 0.2)), other(400, 500, (0.2, 0.3))])
def test_the_sector_fills_the_image(image: CalibratedImage) -> None:
    probe = image.probe
    line, _ = probe.pixel_lookup()
    shown = line >= 0
    assert shown.shape == (image.rows, image.columns)
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    assert rows[0] <= 3, "at the apex of a phased array the sector is narrower than a pixel"
    assert columns[0] <= 1 or rows[-1] >= image.rows - 2
    fan = probe.fan.mask(image.rows, image.columns)
    assert not (fan & ~shown).any(), "no pixel that is not insonified"
    assert fan.sum() > 0.85 * shown.sum()
    assert np.isfinite(beam_tables(probe).lateral).all()


def test_lines_and_samples_lie_where_the_calibration_puts_their_pixels() -> None:
    probe = FCAL.probe
    line, sample = probe.pixel_lookup()
    row, column = np.nonzero((line > 0) & (sample > 0) & (sample < probe.samples - 1))
    some = slice(None, None, 997)
    pixels = np.column_stack([column, row])[some].astype(float)
    line, sample = line[row, column][some], sample[row, column][some]
    angle = np.interp(line, np.arange(probe.lines), probe.line_angles_rad)
    radius = probe.face_radius_mm + (sample + 0.5) * probe.step_mm
    in_plane = np.column_stack([radius * np.sin(angle), radius * np.cos(angle), 0 * angle])
    placed = FCAL.probe_from_plane.apply_array(in_plane)
    np.testing.assert_allclose(placed, FCAL.probe_from_image.apply_pixels(pixels).xyz_mm, atol=1e-3)


@pytest.mark.usefixtures("on_a_ball")
def test_a_scenario_takes_the_calibration_and_keeps_everything_else() -> None:
    spec = ScenarioSpec(seconds=5.0, seed=3)
    without, made = phantom_scenario(spec), phantom_scenario(replace(spec, image=FCAL))
    assert without.truth is not None
    assert made.truth is not None
    assert np.array_equal(made.truth.probe_from_image.matrix, FCAL.probe_from_image.matrix)
    assert made.ultrasound.images is not None
    assert made.ultrasound.images.shape[1:] == (616, 820)
    for name in ("lag_s", "r_peaks_s"):
        assert np.array_equal(getattr(made.truth, name), getattr(without.truth, name))
    assert np.array_equal(made.truth.tip.xyz_mm, without.truth.tip.xyz_mm)
    here, there = (s.truth.mr_from_tracker[0][1].matrix for s in (made, without) if s.truth is not None)
    assert np.array_equal(here, there)
    assert isinstance(made.probe, NWireRecording)
    points = made.probe.points_px[np.isfinite(made.probe.points_px).all(axis=(1, 2))]
    assert ((points > -3) & (points < (823, 619))).all()


@pytest.mark.usefixtures("on_a_ball")
def test_a_shallow_probe_is_held_close_to_the_heart() -> None:
    """The same share of the image lies before the heart as with the standard probe."""
    spec = ScenarioSpec(seconds=5.0, seed=3)
    for image, probe in ((None, SectorProbe()), (FCAL, FCAL.probe)):
        made = phantom_scenario(replace(spec, image=image))
        assert made.truth is not None
        stream = made.ultrasound.poses["tracker_from_probe"]
        apex_px = np.array([probe.apex_px])
        apex = made.truth.probe_from_image.apply_pixels(apex_px).xyz_mm[0]
        tracker = stream.rotations @ apex + stream.translations_mm
        center = made.truth.mr_from_tracker[0][1].inverse().apply_array(np.array([[40.0, -25.0, 60.0]]))
        standoff = np.linalg.norm(tracker[stream.valid] - center, axis=1) - 50.0 - probe.face_radius_mm
        share = standoff / probe.depth_mm
        assert 0.15 < share.min() < share.max() < 0.45


@pytest.mark.parametrize(
    ("columns", "rows", "mm", "words"),
    [
        (20, 600, 0.1, "20 x 600 px"),
        (820, 616, 0.01, "check that the size in pixels"),
        (820, 616, 1.0, "20 to 400"),
    ],
)
def test_an_image_that_cannot_be_one_is_refused(columns: int, rows: int, mm: float, words: str) -> None:
    with pytest.raises(InvalidInputError, match=words):
        other(columns, rows, (mm, mm))


def test_it_reaches_another_process() -> None:
    again = pickle.loads(pickle.dumps(ScenarioSpec(image=FCAL)))
    assert again.image is not None
    assert np.array_equal(again.image.probe_from_image.matrix, FCAL.probe_from_image.matrix)
