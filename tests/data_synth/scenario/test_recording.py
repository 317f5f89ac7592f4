"""A scenario's streams fit together: on a ball for the rules, once on the phantom for the whole chain."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from recorded import latency_of, nwire_of, pivot_of, tool_of

import data_synth.scenario.live as live_module
import data_synth.scenario.recording as scenario_module
from data_synth import (
    HeartSpec,
    ScenarioSpec,
    cine_scenario,
    phantom_scenario,
    replayed_path,
    surface_scenario,
)
from data_synth.heart.anatomy import PhantomAnatomy
from data_synth.heart.tissue import Tissue
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import FloatArray, InvalidInputError, PoseStream, Preop, Rigid, Scenario, Signal


def arrays(made: Scenario) -> list[FloatArray]:
    truth = made.truth
    assert truth is not None
    assert made.start is not None
    assert made.landmarks_tracker is not None
    nwire, latency = nwire_of(made), latency_of(made)
    streams = [tool_of(made), pivot_of(made), nwire.phantom_from_probe, latency.tracker_from_probe]
    streams.append(made.ultrasound.poses["tracker_from_probe"])
    assert isinstance(made.ecg, Signal)
    out = [made.ecg.samples, nwire.points_px, latency.wall_row_px.values, made.start.matrix]
    out += [made.landmarks_tracker.points.xyz_mm, truth.r_peaks_s, truth.tool.distance_mm]
    out += [truth.mr_from_tracker[0][1].matrix, truth.probe_from_image.matrix, truth.tip.xyz_mm]
    return out + [part for s in streams for part in (s.rotations, s.translations_mm)]


@pytest.mark.usefixtures("on_a_ball")
def test_the_same_seed_is_bit_identical_and_another_differs() -> None:
    first, second = (phantom_scenario(ScenarioSpec(seconds=10.0, seed=3)) for _ in range(2))
    other = phantom_scenario(ScenarioSpec(seconds=10.0, seed=4))
    for a, b, c in zip(arrays(first), arrays(second), arrays(other), strict=True):
        assert np.array_equal(a, b, equal_nan=True)
        assert not np.array_equal(a, c, equal_nan=True)


def test_a_seed_set_alone_is_that_of_the_scenario_of_that_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """Anatomy, motion and mismatch of another seed's heart, one at a time."""
    monkeypatch.setattr(scenario_module, "phantom_anatomy", lambda **given: given["heart"])
    mine, other = (scenario_module.scenario_heart(ScenarioSpec(seed=seed)) for seed in (3, 9))
    for name in ("anatomy_seed", "motion_seed", "mismatch_seed"):
        spec = ScenarioSpec(seed=3, heart=HeartSpec("varied", **{name: 9}))
        drawn = scenario_module.scenario_heart(spec)
        assert drawn == replace(mine, kind="varied", **{name: getattr(other, name)})


@pytest.mark.usefixtures("on_a_ball")
def test_other_speckle_changes_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds = []

    def images(
        _: Any, probe: SectorProbe, poses: list[Rigid], __: FloatArray, **given: Any
    ) -> NDArray[np.uint8]:
        seeds.append(given["seed"])
        return np.zeros((len(poses), probe.rows, probe.columns), dtype=np.uint8)

    monkeypatch.setattr(live_module, "simulate_sequence", images)
    specs = ScenarioSpec(seconds=10.0, seed=3), ScenarioSpec(seconds=10.0, seed=9)
    mixed = phantom_scenario(replace(specs[0], heart=HeartSpec(speckle_seed=9)))
    first, _ = (phantom_scenario(spec) for spec in specs)
    assert seeds[0] == seeds[2] != seeds[1]
    for a, b in zip(arrays(first), arrays(mixed), strict=True):
        assert np.array_equal(a, b, equal_nan=True)


@pytest.mark.usefixtures("on_a_ball")
def test_a_longer_recording_keeps_what_does_not_depend_on_its_length() -> None:
    short, long = (phantom_scenario(ScenarioSpec(seconds=s, seed=5)) for s in (10.0, 20.0))
    assert np.array_equal(nwire_of(short).points_px, nwire_of(long).points_px, equal_nan=True)
    assert np.array_equal(pivot_of(short).translations_mm, pivot_of(long).translations_mm)
    assert short.truth is not None
    assert long.truth is not None
    peaks = long.truth.r_peaks_s
    np.testing.assert_array_equal(short.truth.r_peaks_s, peaks[peaks < 10.0])


@pytest.mark.usefixtures("on_a_ball")
def test_a_minute_keeps_its_promises(ball: Any) -> None:
    made = phantom_scenario(ScenarioSpec(seed=1))
    truth = made.truth
    assert truth is not None
    contact = truth.tool
    assert len(contact.t_s) == 60_000
    assert contact.distance_mm[contact.t_s < 12.0].max() < -15.0
    assert (contact.distance_mm >= 0).mean() >= 0.25
    assert contact.distance_mm.max() <= 3.0
    speed = np.linalg.norm(np.diff(contact.tip_mr_mm[::10], axis=0), axis=1) / 0.01
    assert speed.max() <= 32.0
    assert 60 <= len(truth.r_peaks_s) <= 84
    assert 0.02 <= abs(truth.lag_s) <= 0.08
    assert tool_of(made).valid.mean() > 0.99
    assert tool_of(made).rate_hz == pytest.approx(100.0, rel=0.02)
    assert len(made.ultrasound) == pytest.approx(718, abs=2)
    assert made.start is not None
    off = made.start @ truth.mr_from_tracker[0][1].inverse()
    assert np.degrees(off.angle_rad) == pytest.approx(8.0, abs=1e-6)
    center = ball.box_mm.mean(axis=0)
    assert np.linalg.norm(off.apply_array(center) - center) == pytest.approx(10.0, abs=1e-6)


@pytest.mark.usefixtures("on_a_ball")
def test_tracked_tool_and_true_frames_put_the_tip_where_the_truth_says() -> None:
    made = phantom_scenario(ScenarioSpec(seconds=20.0, seed=2))
    truth = made.truth
    assert truth is not None
    rotations, translations, valid = tool_of(made).at_many(truth.tool.t_s)
    tip_tracker = rotations @ truth.tip.xyz_mm[0] + translations
    miss = truth.mr_from_tracker[0][1].apply_array(tip_tracker) - truth.tool.tip_mr_mm
    rms = np.sqrt((miss[valid] ** 2).sum(axis=1).mean())
    lever_mm = np.deg2rad(0.05) * np.sqrt(2 / 3) * np.linalg.norm(truth.tip.xyz_mm)
    assert rms < 1.1 * np.hypot(0.1, lever_mm)
    assert valid.mean() > 0.97


def real_ecg(seconds: float) -> Signal:
    return Signal(np.zeros((int(seconds * 360), 1)), 360.0, 0.0, ("MLII",))


def hand_path() -> PoseStream:
    t = np.arange(0.0, 15.0, 0.08)
    shifts = np.column_stack([20.0 * np.sin(t / 10), t, 0 * t])
    return PoseStream(
        "reference", "probe", t, np.tile(np.eye(3), (len(t), 1, 1)), shifts, np.ones(len(t), bool)
    )


@pytest.mark.usefixtures("on_a_ball")
def test_real_beats_drive_the_heart_and_there_is_no_start() -> None:
    beats = np.cumsum(np.random.default_rng(1).uniform(0.6, 1.2, 60))
    path = replayed_path(hand_path())
    made = surface_scenario(ScenarioSpec(seconds=10.0), {}, real_ecg(30.0), beats, path)
    truth = made.truth
    assert truth is not None
    assert made.start is None
    assert len(made.ecg) == 3600
    np.testing.assert_array_equal(truth.r_peaks_s, beats[beats < 10.0])
    k = int(np.searchsorted(beats, 5.0))
    inside = (truth.tool.t_s > beats[k]) & (truth.tool.t_s < beats[k + 1])
    expected = (truth.tool.t_s[inside] - beats[k]) / (beats[k + 1] - beats[k])
    np.testing.assert_allclose(truth.tool.phi[inside], expected, atol=1e-12)


@pytest.mark.usefixtures("on_a_ball")
def test_an_ecg_that_is_too_short_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="needed 0 to 60 s"):
        surface_scenario(ScenarioSpec(), {}, real_ecg(30.0), np.arange(30.0), replayed_path(hand_path()))


@pytest.mark.usefixtures("on_a_ball")
def test_hearts_with_a_motion_of_their_own_take_no_preset_of_another() -> None:
    spec = ScenarioSpec("still-wall")
    with pytest.raises(InvalidInputError, match="changes how the heart moves, which only the phantom can"):
        surface_scenario(spec, {}, real_ecg(70.0), np.arange(60.0), replayed_path(hand_path()))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"preset": "storm"}, "choose from calm"),
        ({"motion": "fast"}, "choose from paper5mm, physiological"),
        ({"seconds": 1.0}, "needed 5 to 3600"),
        ({"us_rate_hz": 0.0}, "needed 6 to 60"),
        ({"seed": -1}, "non-negative"),
        ({"mismatch_mm": 30.0}, "needed 0 to"),
        ({"preset": "calm storm"}, "wrong-calibration"),
    ],
)
def test_impossible_specifications_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InvalidInputError, match=words):
        ScenarioSpec(**changes)


def test_images_show_the_heart_where_and_when_the_truth_says(
    monkeypatch: pytest.MonkeyPatch, ball: Any, anatomy: PhantomAnatomy
) -> None:
    spec = ScenarioSpec(motion="physiological", seconds=6.0, seed=2, us_rate_hz=6.0)
    monkeypatch.setattr(scenario_module, "phantom_anatomy", lambda **_: anatomy)
    monkeypatch.setattr(scenario_module, "cine_preop", lambda *_: ball.preop())
    made = phantom_scenario(spec)
    truth, sequence = made.truth, made.ultrasound
    assert truth is not None
    assert sequence.images is not None
    stream = sequence.stream("tracker", "probe")
    heart, blood = [], []
    pixels = np.random.default_rng(0).uniform((60, 80), (284, 300), (1500, 2))
    for i in range(4, len(sequence) - 1, 4):
        pose = stream.at(float(sequence.t_s[i]) + truth.lag_s)
        assert pose is not None
        mr = truth.mr_from_tracker[0][1] @ pose
        points = mr.apply(truth.probe_from_image.apply_pixels(pixels)).xyz_mm
        tick = round((float(sequence.t_s[i]) + truth.lag_s) * 1000)
        tissue = anatomy.tissue(points, float(truth.tool.model_phase[tick]))
        column, row = np.round(pixels).astype(int).T
        grey = sequence.images[i, row, column].astype(float)
        visible = made.fan.mask(*sequence.images.shape[1:])[row, column] if made.fan else grey > 0
        heart.append(grey[visible & (tissue == Tissue.LV_MYOCARDIUM)])
        blood.append(grey[visible & np.isin(tissue, (Tissue.LV_BLOOD, Tissue.RV_BLOOD))])
    muscle, pool = np.concatenate(heart), np.concatenate(blood)
    assert len(muscle) > 200
    assert len(pool) > 200
    assert np.mean(muscle) - np.mean(pool) > 60
    threshold = 0.5 * (np.mean(muscle) + np.mean(pool))
    wrong = 0.5 * ((muscle < threshold).mean() + (pool > threshold).mean())
    assert wrong < 0.15  # muscle that runs along the beam is up to 12 dB darker


@pytest.mark.usefixtures("on_a_ball")
def test_a_cines_scenario_has_what_the_laboratory_has(monkeypatch: pytest.MonkeyPatch, ball: Any) -> None:
    given = []

    def anatomy(heart: Any, *, mismatch_mm: float, seed: int, surgery: Any) -> Any:
        given.append((mismatch_mm, seed))
        return ball

    monkeypatch.setattr(scenario_module, "cine_anatomy", anatomy)
    heart = SimpleNamespace(patient_id="somebody", preop=ball.preop)
    first, other = (
        cine_scenario(ScenarioSpec(seconds=10.0, seed=3, heart=HeartSpec(mismatch_seed=seed)), heart)
        for seed in (3, 9)
    )
    assert first.preop.patient_id == "ball"
    assert "somebody" in first.name
    assert first.start is not None
    assert given[0][0] == given[1][0] == 1.2
    assert given[0][1] != given[1][1]
    for a, b in zip(arrays(first), arrays(other), strict=True):
        assert np.array_equal(a, b, equal_nan=True)


def test_recordings_of_an_imaged_heart_differ_by_their_mismatch_alone() -> None:
    spec = ScenarioSpec(seed=5, mismatch_mm=1.0)
    imaged = scenario_module.ImagedHeart(spec, scenario_module.scenario_heart(spec), Preop("phantom"))
    same = ScenarioSpec(seed=5, mismatch_mm=1.0, preset="poor-image")
    other = ScenarioSpec(seed=6, heart=HeartSpec(anatomy_seed=5, motion_seed=5), mismatch_mm=3.0)
    here = imaged.anatomy.ed_vertices_mm
    np.testing.assert_array_equal(imaged.of(same).mismatch.at(here), imaged.anatomy.mismatch.at(here))
    drawn = imaged.of(other)
    np.testing.assert_array_equal(drawn.ed_vertices_mm, here)
    np.testing.assert_array_equal(
        drawn.mismatch.at(here), scenario_module.scenario_heart(other).mismatch.at(here)
    )
    with pytest.raises(InvalidInputError, match="another heart"):
        imaged.of(ScenarioSpec(seed=6))


@pytest.mark.usefixtures("on_a_ball")
def test_points_are_touched_on_the_front_of_the_patients_heart() -> None:
    scenario = phantom_scenario(ScenarioSpec("deformed-touched", seconds=10.0))
    assert scenario.truth is not None
    assert scenario.touched is not None
    surface_mm = scenario.truth.surface.vertices_mm[0]
    touched_mm = scenario.truth.mr_from_tracker_at(0.0).apply(scenario.touched).xyz_mm
    assert len(touched_mm) == 60
    apart_mm = np.linalg.norm(touched_mm[:, None] - surface_mm, axis=2).min(axis=1)
    assert np.sqrt(np.mean(apart_mm**2)) < 1.0
    assert (touched_mm - surface_mm.mean(axis=0))[:, 1].mean() < 0.0  # LPS: in front
