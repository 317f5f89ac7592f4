"""Every preset does what it states, says so in the truth, and leaves the other streams as they were."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from recorded import latency_of, nwire_of, pivot_of, tool_of

from data_synth import PRESETS, Preset, ScenarioSpec, phantom_scenario
from data_synth.scenario.displacement import STEP_S
from data_synth.scenario.world import image_middle_mm
from data_synth.signals.tracker import TrackerSpec
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import FloatArray, ImageMap, Scenario, ScenarioTruth, Signal

SECONDS = 16.0
HALF_S = 0.5 * SECONDS


@cache
def made(preset: str = "calm", changed: Preset | None = None) -> tuple[Scenario, ScenarioTruth]:
    scenario = phantom_scenario(ScenarioSpec(preset, seconds=SECONDS, seed=3, changed=changed))
    assert scenario.truth is not None
    return scenario, scenario.truth


def streams(scenario: Scenario) -> dict[str, list[FloatArray]]:
    """Arrays of every stream by its name."""
    truth, probe = scenario.truth, scenario.ultrasound.poses["tracker_from_probe"]
    assert truth is not None
    assert scenario.ultrasound.images is not None
    assert scenario.start is not None
    assert scenario.landmarks_tracker is not None
    poses = {
        "tool": tool_of(scenario),
        "probe": probe,
        "pivot": pivot_of(scenario),
        "nwire": nwire_of(scenario).phantom_from_probe,
        "latency": latency_of(scenario).tracker_from_probe,
    }
    out = {name: [s.t_s, s.rotations, s.translations_mm] for name, s in poses.items()}
    out["nwire"].append(nwire_of(scenario).points_px)
    out["latency"].append(latency_of(scenario).wall_row_px.values)
    assert isinstance(scenario.ecg, Signal)
    out["ecg"] = [scenario.ecg.samples]
    out["ecg clock"] = [scenario.ecg.t_s]
    out["images"] = [scenario.ultrasound.images[::10].astype(np.float64)]
    out["start"] = [scenario.start.matrix, scenario.landmarks_tracker.points.xyz_mm]
    out["contact"] = [truth.tool.tip_mr_mm, truth.tool.distance_mm]
    out["ground truth"] = [
        truth.mr_from_tracker[0][1].matrix,
        truth.probe_from_image.matrix,
        truth.tip.xyz_mm,
    ]
    return out


CHANGED = {
    "calm": set(),
    "tachycardia": {"ecg", "contact", "tool"},
    "ectopy": {"ecg", "contact", "tool"},
    "line-of-sight-loss": {"tool", "probe"},
    "probe-slip": {"probe"},
    "patient-shift": {"tool", "probe"},
    "poor-image": {"probe"},
    "wrong-calibration": {"nwire", "latency"},
    "lost-ultrasound": {"tool", "probe", "images"},
    "noise-ultrasound": {"images"},
    "black-ultrasound": set(),
    "frozen-ultrasound": set(),
    "frozen-tool": {"tool"},
    "tool-clock-restart": {"tool"},
    "late-ecg": {"ecg clock"},
    "tool-in-view": {"probe", "images"},
    "tool-elsewhere": {"probe", "images", "nwire", "latency"},
    "tool-unseen": {"probe"},
    "deformed": set(),
    "deformed-touched": set(),
    "other-motion": set(),
    "still-wall": set(),
    "ventilated": {"ecg", "contact", "tool"},
    "breathing": {"ecg", "contact", "tool"},
    "unrecorded-breathing": {"ecg", "contact", "tool"},
    "atrial": {"contact", "tool"},
}
"""The ball's images are black and all alike: in themselves, repeated or gone they are the same. Its shape is
the same in every preset."""


@pytest.mark.usefixtures("on_a_ball")
def test_a_preset_changes_its_own_streams_and_no_other() -> None:
    calm = streams(made()[0])
    assert set(CHANGED) == set(PRESETS)
    for preset, changed in CHANGED.items():
        other = streams(made(preset)[0])
        for name, arrays in calm.items():
            same = all(
                a.shape == b.shape and np.array_equal(a, b, equal_nan=True)
                for a, b in zip(arrays, other[name], strict=True)
            )
            assert same is (name not in changed), (preset, name)


def image_poses(scenario: Scenario, truth: ScenarioTruth) -> tuple[FloatArray, FloatArray]:
    """(n, 3) middle of every image in frame "mr" through the truth that holds, and (n,) its pose's time."""
    stream = scenario.ultrasound.poses["tracker_from_probe"]
    middle = np.array([[171.5, 159.5]])
    points = np.full((len(stream), 3), np.nan)
    for i in np.flatnonzero(stream.valid):
        at = float(stream.t_s[i])
        mr_from_probe = truth.mr_from_tracker_at(at) @ stream.pose(int(i))
        points[i] = mr_from_probe.apply(truth.probe_from_image_at(at).apply_pixels(middle)).xyz_mm[0]
    return points, stream.t_s


@pytest.mark.usefixtures("on_a_ball")
@pytest.mark.parametrize("preset", ["probe-slip", "patient-shift"])
def test_images_stay_where_they_were_through_the_truth_of_a_changed_pose(preset: str) -> None:
    # noise is drawn alike, so only its turning with the frames is left: well below twice its RMS
    noise_mm = np.hypot(0.2, np.deg2rad(0.1) * 150.0)
    calm, _ = image_poses(*made())
    scenario, truth = made(preset)
    seen, t_s = image_poses(scenario, truth)
    both = np.isfinite(calm[:, 0]) & np.isfinite(seen[:, 0])
    assert both.mean() > 0.9
    apart = np.linalg.norm(seen - calm, axis=1)[both]
    changing = (t_s[both] > HALF_S) & (t_s[both] < HALF_S + 0.5)
    assert apart[~changing].max() < 4.5 * noise_mm
    # half a step of the truth at the peak speed of the change, 1.875 · 8 mm / 0.5 s (and 3° on 200 mm)
    assert apart.max() < 4.5 * noise_mm + 0.5 * STEP_S * 1.875 / 0.5 * (8.0 + np.deg2rad(3.0) * 200.0)


@pytest.mark.usefixtures("on_a_ball")
def test_the_patient_moves_by_what_is_stated(ball: object) -> None:
    scenario, truth = made("patient-shift")
    (_, first), *later = truth.mr_from_tracker
    start_s, last = later[-1]
    assert later[0][0] == pytest.approx(HALF_S)
    assert start_s == pytest.approx(HALF_S + 0.5)
    change = last @ first.inverse()
    center = ball.box_mm.mean(axis=0)  # type: ignore[attr-defined]
    assert np.linalg.norm(change.apply_array(center) - center) == pytest.approx(8.0, abs=1e-9)
    assert np.degrees(change.angle_rad) == pytest.approx(3.0, abs=1e-9)
    rotations, translations, valid = tool_of(scenario).at_many(truth.tool.t_s)
    tip = rotations @ truth.tip.xyz_mm[0] + translations
    for after, pose in ((False, first), (True, last)):
        held = valid & ((truth.tool.t_s > HALF_S + 0.6) if after else (truth.tool.t_s < HALF_S - 0.1))
        miss = pose.apply_array(tip[held]) - truth.tool.tip_mr_mm[held]
        assert np.sqrt((miss**2).sum(axis=1).mean()) < 0.2


@pytest.mark.usefixtures("on_a_ball")
def test_a_probe_is_laid_aside_and_then_the_patient_moves() -> None:
    scenario, truth = made("lost-ultrasound")
    sequence = scenario.ultrasound
    taken_s = sequence.t_s + truth.lag_s
    probe, images = sequence.poses["tracker_from_probe"], sequence.images
    assert images is not None
    assert not probe.valid[probe.t_s >= HALF_S].any()
    assert probe.valid[probe.t_s < HALF_S].mean() > 0.95
    np.testing.assert_array_equal(images.any(axis=(1, 2)), taken_s >= HALF_S)
    (_, first), *later = truth.mr_from_tracker
    assert HALF_S + 2.0 <= later[0][0] <= HALF_S + 10.0
    assert later[-1][0] - later[0][0] == pytest.approx(0.5)
    change = later[-1][1] @ first.inverse()
    assert change.angle_rad == pytest.approx(0.0, abs=1e-9)
    assert 8.0 <= np.linalg.norm(change.translation_mm) <= 15.0


@pytest.mark.usefixtures("on_a_ball")
def test_a_tool_freezes_while_the_true_one_goes_on() -> None:
    (scenario, truth), (calm, _) = made("frozen-tool"), made()
    tool, whole = tool_of(scenario), tool_of(calm)
    frozen = (tool.t_s >= HALF_S) & (tool.t_s < HALF_S + 20.0)
    assert tool.valid[frozen].all()
    assert (np.diff(tool.translations_mm[frozen], axis=0) == 0).all()
    assert (np.diff(tool.rotations[frozen], axis=0) == 0).all()
    np.testing.assert_array_equal(tool.translations_mm[~frozen], whole.translations_mm[~frozen])
    assert np.ptp(truth.tool.tip_mr_mm[truth.tool.t_s >= HALF_S], axis=0).max() > 5.0


@pytest.mark.usefixtures("on_a_ball")
def test_the_tool_s_clock_restarts_ten_seconds_back() -> None:
    (scenario, _), (calm, _) = made("tool-clock-restart"), made()
    before, after = tool_of(scenario), scenario.tool_after_restart
    assert after is not None
    assert calm.tool_after_restart is None
    assert len(before) + len(after) == len(tool_of(calm))
    assert before.t_s[-1] == pytest.approx(HALF_S, abs=0.02)
    np.testing.assert_allclose(after.t_s, tool_of(calm).t_s[len(before) :] - 10.0, atol=1e-9)
    np.testing.assert_array_equal(after.rotations, tool_of(calm).rotations[len(before) :])


@pytest.mark.usefixtures("on_a_ball")
def test_the_ecg_is_late_by_the_same_time_throughout() -> None:
    (scenario, truth), (calm, calm_truth) = made("late-ecg"), made()
    np.testing.assert_allclose(scenario.ecg.t_s - calm.ecg.t_s, 0.3, atol=1e-12)
    np.testing.assert_array_equal(truth.r_peaks_s, calm_truth.r_peaks_s)


@pytest.mark.usefixtures("on_a_ball")
def test_the_marker_slips_by_what_is_stated() -> None:
    _, truth = made("probe-slip")
    ((start_s, later),) = truth.later_probe_from_image
    assert start_s == HALF_S
    assert moved_mm_deg(truth.probe_from_image, later) == pytest.approx((6.0, 4.0), abs=1e-6)


def moved_mm_deg(first: ImageMap, second: ImageMap) -> tuple[float, float]:
    middle = [image_middle_mm(image, SectorProbe()) for image in (first, second)]
    turn = first.rigid.inverse() @ second.rigid
    return float(np.linalg.norm(middle[1] - middle[0])), float(np.degrees(turn.angle_rad))


def off_wire_mm(scenario: Scenario, image: ImageMap) -> float:
    """RMS distance of the segmented points from their wires through an image calibration."""
    recording = nwire_of(scenario)
    misses = []
    for i in range(len(recording.phantom_from_probe)):
        pixels = recording.points_px[i]
        if not recording.phantom_from_probe.valid[i] or np.isnan(pixels).any():
            continue
        seen = recording.phantom_from_probe.pose(i).apply(image.apply_pixels(pixels)).xyz_mm
        for wire, point in zip(recording.phantom.wires, seen, strict=True):
            along = (wire.back_mm - wire.front_mm) / np.linalg.norm(wire.back_mm - wire.front_mm)
            misses.append(np.cross(along, point - wire.front_mm))
    return float(np.sqrt((np.array(misses) ** 2).sum(axis=1).mean()))


@pytest.mark.usefixtures("on_a_ball")
def test_the_wrong_calibration_is_of_the_stated_other_probe() -> None:
    scenario, truth = made("wrong-calibration")
    recorded = truth.calibrated_probe_from_image
    assert recorded is not None
    assert moved_mm_deg(truth.probe_from_image, recorded) == pytest.approx((6.0, 4.0), abs=1e-6)
    # 0.2 mm a pixel axis, 0.2 mm and 0.1° (on some 150 mm) of the tracker
    assert off_wire_mm(scenario, recorded) < 1.2 * np.sqrt(2 * 0.2**2 + 0.2**2 + (np.deg2rad(0.1) * 150) ** 2)
    assert off_wire_mm(scenario, truth.probe_from_image) > 2.0
    assert made()[1].calibrated_probe_from_image is None


@pytest.mark.usefixtures("on_a_ball")
def test_sight_is_lost_for_seconds_while_the_tool_touches() -> None:
    scenario, truth = made("line-of-sight-loss")
    tool = tool_of(scenario)
    edges = np.flatnonzero(np.diff(np.concatenate([[1], tool.valid.astype(int), [1]])))
    gaps = (edges[1::2] - edges[::2]) / 100.0
    assert (gaps > 1.4).sum() == 1
    assert gaps.max() < 4.1
    touching = np.interp(tool.t_s, truth.tool.t_s, truth.tool.distance_mm) >= 0
    assert (~tool.valid & touching).sum() > 50
    probe = scenario.ultrasound.poses["tracker_from_probe"]
    assert 1.3 < (~probe.valid).sum() / 12.0 < 4.3


@pytest.mark.usefixtures("on_a_ball")
@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_the_operator_stays_gentle_whatever_happens(preset: str) -> None:
    contact = made(preset)[1].tool
    assert contact.distance_mm.max() <= 3.0
    assert (contact.distance_mm >= 0).mean() > 0.1


@pytest.mark.usefixtures("on_a_ball")
def test_breathing_carries_heart_probe_view_and_hand() -> None:
    calm_scenario, _ = made()
    scenario, truth = made("ventilated")
    assert truth.respiration_mm == 10.0
    assert truth.breathing is not None
    moved = truth.breathing.targets_at(truth.tool.t_s) - truth.targets.points.xyz_mm
    size = np.linalg.norm(moved.mean(axis=1), axis=1)
    assert size.max() == pytest.approx(10.0, abs=1.0)
    assert size.min() < 0.5
    assert scenario.respiration is not None
    pressure = scenario.respiration
    follows = np.corrcoef(pressure.values[:, 0], np.interp(pressure.t_s - 0.05, truth.tool.t_s, size))[0, 1]
    assert follows > 0.85
    assert scenario.chest is not None
    assert calm_scenario.respiration is None
    rotations, translations, valid = tool_of(scenario).at_many(truth.tool.t_s)
    tip = rotations @ truth.tip.xyz_mm[0] + translations
    miss = truth.mr_from_tracker[0][1].apply_array(tip[valid]) - truth.tool.tip_mr_mm[valid]
    assert np.sqrt((miss**2).sum(axis=1).mean()) < 0.2
    np.testing.assert_array_equal(
        scenario.ultrasound.poses["tracker_from_probe"].translations_mm,
        calm_scenario.ultrasound.poses["tracker_from_probe"].translations_mm,
    )


@pytest.mark.usefixtures("on_a_ball")
def test_a_drifting_video_clock_and_a_late_tracker() -> None:
    calm_scenario, calm = made()
    drifting = replace(Preset(), video_drift_ppm=800.0)
    scenario, truth = made(changed=drifting)
    assert truth.video_drift_ppm == 800.0
    event_s = scenario.ultrasound.t_s * (1 + 800e-6) + truth.lag_s
    np.testing.assert_allclose(event_s, calm_scenario.ultrasound.t_s + calm.lag_s, atol=2e-6)
    late = replace(Preset(), probe_tracker=TrackerSpec(12.0, 0, 0, 0, 0, latency_s=0.05))
    exact = replace(Preset(), probe_tracker=TrackerSpec(12.0, 0, 0, 0, 0))
    after, before = (made(changed=c)[0].ultrasound.poses["tracker_from_probe"] for c in (late, exact))
    middle = after.t_s[5:-5]
    _, wanted, _ = before.at_many(middle - 0.05)
    # linear interpolation over 1/12 s of a hand that tremors by 0.05 mm and accelerates by some 100 mm/s²
    assert np.abs(wanted - after.translations_mm[5:-5]).max() < 0.3
    assert np.abs(before.translations_mm - after.translations_mm).max() > 0.5
