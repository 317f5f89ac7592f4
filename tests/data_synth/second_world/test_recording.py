"""One heart of the second world: its truth, and what MR, contours and scanner make of it."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import data_synth
from data_synth.heart import anatomy
from data_synth.heart.outline import outline
from data_synth.heart.tissue import Tissue
from data_synth.second_world import tissue_fields
from data_synth.second_world.changed_heart import best_rigid, vertex_areas
from data_synth.second_world.cine import examine, segmented
from data_synth.second_world.drawn import Drawn
from data_synth.second_world.echo_images import drawn_display, echo_images
from data_synth.second_world.floor import matched_points, rigid_floor
from data_synth.second_world.gated_volumes import SecondWorldPair
from data_synth.second_world.measured_poses import distorted_field
from data_synth.second_world.operating_room import OperatingRoom, image_map
from data_synth.second_world.probes import insonified
from data_synth.second_world.properties import EFFUSION
from data_synth.second_world.ranges import RANGES, Range
from data_synth.second_world.recording import (
    SecondWorldRecording,
    SecondWorldSpec,
    second_world_recording,
)
from data_synth.second_world.sweeps import sweep
from data_synth.ultrasound.volume import MatrixProbe
from dvf_ig.cli.synth.commands import app
from dvf_ig.core import InvalidInputError, Rigid
from dvf_ig.intake import read_scenario
from dvf_ig.preop import ModelOptions, model_from_labels
from dvf_ig.replay.registration import prepare_registration


@pytest.fixture(scope="module")
def recording() -> SecondWorldRecording:
    """Five seconds of seed 5002 (a development seed), with as many images as it takes to register.

    Tissue and outline are drawn on wider grids than a study's, and the MR has fewer phases: half the time.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tissue_fields, "SPACING_MM", 3.5)
        patch.setitem(RANGES, "mr.phases", Range(12.0, 12.0))
        patch.setattr(anatomy, "outline", partial(outline, step_mm=5.0))
        anatomy._at_rest.cache_clear()
        made = second_world_recording(SecondWorldSpec(seed=5002, seconds=5.0, us_rate_hz=8.0))
    anatomy._at_rest.cache_clear()  # no other test meets the coarse heart
    return made


@pytest.fixture(scope="module")
def room(recording: SecondWorldRecording) -> OperatingRoom:
    return recording.room


class Quiet(Drawn):
    """A heart's values without the errors between the image and the tracker."""

    def __getitem__(self, name: str) -> float:
        exact = ("tracker.bias_mm", "tracker.bias_deg", "tracker.drift_mm", "image.sound_speed")
        return 0.0 if name in (*exact, "calibration.lag_error_s") else Drawn.__getitem__(self, name)


@pytest.fixture(scope="module")
def exact_room(room: OperatingRoom) -> OperatingRoom:
    """The same room with an exact tracker, calibration and speed of sound."""
    quiet = Quiet(room.drawn.seed, room.drawn.quality)
    box = np.array([[-400.0] * 3, [400.0] * 3])
    still = replace(distorted_field(box, room.drawn), drawn=quiet)
    still = replace(
        still,
        shift=replace(still.shift, displacement_mm=0 * still.shift.displacement_mm),
        turn=replace(still.turn, displacement_mm=0 * still.turn.displacement_mm),
    )
    return replace(room, drawn=quiet, field=still, calibrated=image_map(room.probe_from_plane, room.probe))


def test_tissue_rides_on_the_motion_of_the_surface(room: OperatingRoom) -> None:
    for phase in (0.0, 0.17, 0.36, 0.7):
        now = room.changed.surface_vertices(phase)
        np.testing.assert_allclose(room.changed.material(now, phase), room.heart.ed_vertices_mm, atol=0.02)
        np.testing.assert_allclose(room.surface.at(phase), now, atol=0.01)


def test_the_true_pose_is_the_best_rigid_one_of_the_moving_surface(room: OperatingRoom) -> None:
    phases = (np.arange(16) / 16).tolist()
    then = np.concatenate(
        [room.heart.resting_motion.push_forward(room.heart.ed_vertices_mm, p) for p in phases]
    )
    now = np.concatenate([room.changed.surface_vertices(p) for p in phases])
    weights = np.tile(vertex_areas(room.heart.ed_vertices_mm, room.heart.triangles), 16)
    rest = best_rigid(now, then, "mr", "mr", weights)
    assert rest.angle_rad < 1e-4
    assert np.linalg.norm(rest.apply_array(room.heart.box_mm) - room.heart.box_mm, axis=1).max() < 0.01
    rms = np.sqrt(np.average(((now - then) ** 2).sum(axis=1), weights=weights))
    assert room.changed_rms_mm == pytest.approx(rms, rel=1e-3)
    assert 0.4 < rms < 5.0


def test_without_errors_of_the_tracker_images_show_the_changed_heart_where_it_is(
    exact_room: OperatingRoom,
) -> None:
    times = np.linspace(0.2, 4.8, 40)
    seen, meant = matched_points(exact_room, times)
    placed = exact_room.mr_from_tracker.apply_array(seen)
    assert len(seen) > 500
    # what remains is the change of the heart itself
    assert np.sqrt(((placed - meant) ** 2).sum(axis=1).mean()) < 2.0 * exact_room.changed_rms_mm
    assert rigid_floor(exact_room, times).pose_mm < exact_room.changed_rms_mm


def test_the_floor_counts_the_distorted_field(
    room: OperatingRoom, exact_room: OperatingRoom, recording: SecondWorldRecording
) -> None:
    moved = replace(exact_room, mr_from_tracker=_shifted(exact_room.mr_from_tracker, 3.0))
    assert 0.0 < recording.floor.pose_mm < 3.0
    assert recording.floor.residual_mm < 5.0
    # a true pose that is 3 mm off is found to be 3 mm off
    seen, meant = matched_points(exact_room, np.linspace(0.2, 4.8, 40))
    best = best_rigid(seen, meant, "mr", "tracker")
    targets = room.heart.targets.points.xyz_mm
    there = moved.mr_from_tracker.inverse().apply_array(targets)
    assert np.linalg.norm(best.apply_array(there) - targets, axis=1).mean() == pytest.approx(3.0, abs=1.5)


def _shifted(pose: Rigid, by_mm: float) -> Rigid:
    return pose.perturbed_left(np.zeros(3), np.array([by_mm, 0.0, 0.0]), np.zeros(3))


def test_the_scenario_says_what_was_true(recording: SecondWorldRecording, room: OperatingRoom) -> None:
    scenario, truth = recording.scenario, recording.scenario.truth
    assert truth is not None
    np.testing.assert_array_equal(truth.mr_from_tracker_at(3.0).matrix, room.mr_from_tracker.matrix)
    np.testing.assert_array_equal(truth.targets.points.xyz_mm, room.heart.targets.points.xyz_mm)
    assert scenario.start is not None
    assert 0.0 <= truth.r_peaks_s[0] <= truth.r_peaks_s[-1] < 5.0
    touched, _ = room.surface.distance(
        np.array(truth.tool.tip_mr_mm[::50]), np.array(truth.tool.model_phase[::50])
    )
    np.testing.assert_allclose(touched, truth.tool.distance_mm[::50], atol=1e-9)
    np.testing.assert_allclose(room.clock.model_phase(truth.tool.t_s), truth.tool.model_phase)
    assert truth.mismatch_mm == recording.floor.changed_rms_mm


def test_the_same_seed_gives_the_same_recording(recording: SecondWorldRecording, room: OperatingRoom) -> None:
    path, _ = sweep(room.heart, room.fields.reference, room.drawn)
    times = np.array([0.3, 4.0])
    for one, other in zip(path(times), room.mr_from_plane(times), strict=True):
        np.testing.assert_array_equal(one, other)
    shown = recording.scenario.ultrasound
    assert shown.images is not None
    taken_s = shown.t_s[:2] + room.lag_s
    poses = [Rigid("mr", "plane", r, t) for r, t in zip(*room.mr_from_plane(taken_s), strict=True)]
    line_s = 1.4e-6 * room.probe.depth_mm
    within = (np.arange(room.probe.lines) - 0.5 * (room.probe.lines - 1)) * line_s
    phases = room.clock.model_phase(taken_s[:, None] + within)
    again = echo_images(
        [room.changed] * len(poses), room.probe, poses, phases, taken_s, room.drawn, lambda done: None
    )
    np.testing.assert_array_equal(again, shown.images[:2])


@pytest.mark.parametrize("given", [{"seconds": 2.0}, {"us_rate_hz": 200.0}, {"motion": "fast"}])
def test_impossible_specifications_are_refused(given: dict[str, float | str]) -> None:
    with pytest.raises(InvalidInputError):
        SecondWorldSpec(**given)


def test_contours_miss_the_epicardium_by_the_drawn_noise_and_bias(
    recording: SecondWorldRecording, room: OperatingRoom
) -> None:
    """Along rays from the middle: where the labels end, and where the surface at end-diastole is."""
    labels = recording.scenario.preop.labels
    assert labels is not None
    grid, heart = labels.grid, labels.values[0] > 0
    middle = room.heart.ed_vertices_mm.mean(axis=0)
    out = room.heart.ed_vertices_mm - middle
    reach = np.linalg.norm(out, axis=1)
    rays = (out / reach[:, None])[::7]
    depth = np.arange(-8.0, 8.0, 0.25)
    points = middle + (reach[::7, None] + depth)[..., None] * rays[:, None]
    index = np.rint(grid.to_index(points.reshape(-1, 3))).astype(int)
    index = np.clip(index, 0, np.array(grid.shape) - 1)
    inside = heart[tuple(index.T)].reshape(len(rays), -1)
    ends = inside[:, 0] & ~inside[:, -1] & (np.diff(inside.astype(int), axis=1) != 0).sum(axis=1).__eq__(1)
    miss = depth[inside[ends].sum(axis=1) - 1]
    noise, bias = room.drawn["labels.noise_mm"], room.drawn["labels.outer_bias_mm"]
    assert ends.sum() > 200
    # the voxel, shifted slices and oblique rays add to the noise
    assert noise - 0.3 < float(np.subtract(*np.quantile(miss, [0.84, 0.16]))) / 2 < 2 * noise + 1.0
    assert float(np.median(miss)) == pytest.approx(bias, abs=0.6)


def test_layers_around_the_heart_stay_within_their_ranges(room: OperatingRoom) -> None:
    reference = room.fields.reference
    around = -reference.organ_mm[reference.outer == Tissue.FAT]
    assert around.max() <= 12.0
    fluid = -reference.organ_mm[reference.outer == EFFUSION]
    assert len(fluid) == 0 or fluid.max() <= 22.0
    muscle = (reference.inner == Tissue.LV_MYOCARDIUM) & (reference.organ_mm > 3)
    level = 20 * np.log10(np.maximum(reference.acoustics[..., 2][muscle], 1e-6))
    most = room.drawn["muscle.regional_db"]
    assert (np.abs(level) < most + 0.1).mean() > 0.75
    assert np.std(level[np.abs(level) < most + 0.1]) > 0.15 * most


def test_strong_echoes_bloom_and_come_once_more(room: OperatingRoom) -> None:
    display = drawn_display(room.probe, room.drawn)
    plain = replace(display, gain_db=0 * display.gain_db, dropouts=())
    level = np.full((room.probe.lines, room.probe.samples), -60.0, dtype=np.float32)
    line, sample = room.probe.lines // 2, room.probe.samples // 4
    level[line, sample] = 30.0
    grey = plain.grey(level, 0.0)
    dark = plain.grey(np.full_like(level, -60.0), 0.0)
    late = sample + round(room.drawn["image.reverberation_mm"] / room.probe.step_mm)
    assert (grey[line, sample - 1 : sample + 2] > dark[line, sample]).all()
    assert grey[line + 1, sample] > dark[line + 1, sample]
    assert grey[line, late] > dark[line, late]
    assert grey[line, sample] > grey[line, late]


def test_grey_grows_with_the_echo_from_black_to_white(room: OperatingRoom) -> None:
    probe = room.probe
    plain = replace(
        drawn_display(probe, room.drawn), gain_db=np.zeros((probe.lines, probe.samples)), dropouts=()
    )
    floor = probe.top_db - probe.dynamic_range_db
    shown = [
        float(plain.grey(np.full((probe.lines, probe.samples), db, dtype=np.float32), 0.0)[0, 0])
        for db in np.linspace(floor - 5.0, probe.top_db + 5.0, 12)
    ]
    assert (np.diff(shown) >= 0).all()
    assert shown[0] == 0.0
    assert shown[-1] == 255.0


def test_faster_sound_shows_tissue_too_shallow(room: OperatingRoom) -> None:
    true = insonified(room.probe, 0.015)
    np.testing.assert_allclose(true.depths_mm, 1.015 * room.probe.depths_mm)
    assert RANGES["image.sound_speed"].high == 0.015


def test_a_recording_is_written_with_its_floor_and_holds_what_a_registration_needs(
    tmp_path: Path, recording: SecondWorldRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(data_synth, "second_world_recording", lambda spec, progress: recording)
    folder = tmp_path / "scenario"
    done = CliRunner().invoke(
        app,
        ["scenario", "--world", "second", "--seed", "5002", "--seconds", "5", "-o", str(folder), "--json"],
    )
    assert done.exit_code == 0
    assert f'"pose_mm": {recording.floor.pose_mm}' in done.output
    assert "image.persistence" in (folder / "truth" / "spec.yaml").read_text()
    read = read_scenario(folder)
    assert read.preset == recording.scenario.preset
    coarse = model_from_labels(read.preop, options=ModelOptions(knot_spacing_mm=12.0))
    assert prepare_registration(read, model=coarse).frames.enough


def test_gated_volumes_show_the_heart_where_their_poses_say(room: OperatingRoom) -> None:
    pair = SecondWorldPair(
        room.heart, room.fields, room.changed, room.changed_rms_mm, room.mr_from_tracker, room.drawn
    )
    small = replace(pair.array.sector, lines=16, samples=128)
    pair.__dict__["array"] = MatrixProbe(small, 16, 3.0)
    volumes = pair.volumes((0.36,))
    assert [v.model_phase for v in volumes] == [0.36, 0.36]
    for view, volume in zip(pair.views, volumes, strict=True):
        read = pair.mr_from_tracker @ volume.tracker_from_image
        off = read.apply_array(pair.center_mm[None]) - view.apply_array(pair.center_mm[None])
        assert 0.0 < np.linalg.norm(off) < 8.0
        shown = volume.image.values[volume.mask.values > 0]
        assert 5.0 < shown.mean() < 230.0
        assert shown.std() > 10.0
    assert 0.0 < pair.floor.pose_mm < 4.0


def test_an_observer_draws_the_heart_of_an_examination_with_errors(room: OperatingRoom) -> None:
    examined = examine(room.heart, room.fields, "sax7", room.drawn, 2)
    preop = segmented(examined, room.heart, room.fields, room.drawn)
    assert (preop.labels, preop.views) == (None, ())
    assert preop.ed_labels is not None
    drawn, true = preop.ed_labels.values > 0, examined.sax.labels.values[0] > 0
    assert drawn.shape[2] == 7
    assert set(np.unique(preop.ed_labels.values)) == {0, *preop.organ_labels}
    assert 0.9 < 2.0 * (drawn & true).sum() / (drawn.sum() + true.sum()) < 0.995
    grey = examined.sax.image.values[0]
    assert grey[true].mean() > 1.2 * grey[~true].mean()
