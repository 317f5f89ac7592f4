"""Breathing in a session: frames moved to rest exactly, motion learnt from beats, withheld in time."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth.breathing.breaths import BreathEvent
from data_synth.breathing.motion import Breathing
from dvf_ig.cardiac.respiration import BreathState
from dvf_ig.core import FloatArray, Respiration
from dvf_ig.registration import PoseChart
from dvf_ig.registration.unfollowed_breathing import LEAST_BEATS
from dvf_ig.session import UNFOLLOWED, RespirationSample
from dvf_ig.session.breathing import BreathingRecord, BreathingTracker, no_log
from dvf_ig.session.breathing_motion import FrameBreathing, moved_to_rest
from dvf_ig.session.reasons import BreathingReason
from dvf_ig.study import breathing
from dvf_ig.study.breathing import BEYOND_VOLUME, CENTER, LEARNT_S, NOISE_MM, RESTING, VENTILATED, measured

STOP_S = 90.0
Events = tuple[tuple[BreathEvent, float], ...]


def world(events: Events = (), until_s: float = STOP_S) -> tuple[Breathing, Respiration]:
    return breathing.breathing_world(replace(VENTILATED, events=events), until_s, 2)


def follow(
    events: Events = (), until_s: float = STOP_S, late_s: float = 0.0, log: breathing.Log = no_log
) -> breathing.Followed:
    return breathing.follow(replace(VENTILATED, events=events), until_s, 2, late_s, log)


def follow_by_ecg(
    excursion_mm: float, events: Events = (), log: breathing.Log = no_log
) -> breathing.Followed:
    spec = replace(VENTILATED, excursion_mm=excursion_mm, events=events)
    return breathing.follow_by_ecg(spec, 62.0, 4, log=log)


def test_frames_moved_to_rest_see_there_what_they_saw_in_the_breath() -> None:
    rng = np.random.default_rng(0)
    xi = 8.0 * rng.standard_normal((4, 6))
    chart = PoseChart(RESTING.end, np.array([3.0, -8.0, 12.0]))
    turns, shifts = Rotation.random(4, rng=rng).as_matrix(), 90.0 * rng.standard_normal((4, 3))
    at_rest = moved_to_rest(turns, shifts, xi, chart)
    points = rng.standard_normal((5, 3))
    for k in range(4):
        seen = chart.pose(xi[k]).apply_array(points @ turns[k].T + shifts[k])
        again = chart.base.apply_array(points @ at_rest[0][k].T + at_rest[1][k])
        np.testing.assert_allclose(again, seen, atol=1e-9)


def watch_beat(tracker: BreathingTracker, begin_s: float, xi_mm: FloatArray) -> None:
    """Compare a beat with RESTING, which is `xi_mm` from where it shows the heart."""
    tracker.watch(begin_s + 0.4, begin_s + 1.1, measured(xi_mm), np.zeros((3, 3)))


def test_without_samples_there_is_no_force_until_beats_exclude_breathing() -> None:
    tracker, rng = BreathingTracker(CENTER), np.random.default_rng(3)
    tracker.advance(5.0)
    assert tracker.frames(np.array([1.0])) is None
    assert tracker.motion(RESTING, 5.0) is RESTING
    assert not tracker.status(5.0).covariance_mm2.any()
    for k in range(LEAST_BEATS):
        assert tracker.withheld(10.0 + k)
        assert tracker.status(10.0 + k).reason == (BreathingReason.NOT_EXCLUDED.value if k else None)
        watch_beat(tracker, 9.0 + k, NOISE_MM * rng.standard_normal(6))
    assert not tracker.withheld(30.0)
    assert tracker.status(30.0).reason is None


@pytest.mark.parametrize("excursion_mm", [4.0, 10.0])
def test_the_ecg_follows_a_breath_that_nothing_records_and_force_is_given_at_rest(
    excursion_mm: float,
) -> None:
    records: list[BreathingRecord] = []
    times, errors, withheld, tracker = follow_by_ecg(excursion_mm, log=records.append)
    assert withheld[times < 15.0].all()
    served = ~withheld & (times > 25.0)
    assert 0.15 < served.sum() / (times > 25.0).sum() < 0.45
    assert np.percentile(errors[served], 95) < 1.5
    assert tracker.model is None  # what happens between two beats is not noticed at once
    assert tracker.status(float(times[-1])).reason == BreathingReason.BY_ECG.value
    assert tracker.status(float(times[-1])).bound_mm > 0.0
    assert [record.by_ecg for record in records] == [False, True]
    assert records[0].unfollowed_mm == pytest.approx(excursion_mm, rel=0.4)


@pytest.mark.parametrize("event", ["pause", "disconnection", "sigh", "doubled-rate"])
def test_a_breath_that_the_ecg_did_not_forecast_is_no_rest(event: str) -> None:
    times, errors, withheld, _ = follow_by_ecg(10.0, ((event, 40.0),))
    assert errors[~withheld & (times > 25.0)].max() < 5.0


@cache
def quiet() -> tuple[breathing.Followed, list[BreathingRecord]]:
    """Follow a world without events, and what the tracker recorded."""
    records: list[BreathingRecord] = []
    return follow(log=records.append), records


def test_the_gate_serves_end_expiration_until_the_motion_is_learnt() -> None:
    (times, errors, withheld, tracker), _ = quiet()
    gated = (times > 16.0) & (times < 45.0) & ~withheld
    assert 0.15 < gated.sum() / ((times > 16.0) & (times < 45.0)).sum() < 0.45
    assert np.percentile(errors[gated], 95) < 1.5
    after = times > LEARNT_S
    assert tracker.model is not None
    assert (~withheld[after]).mean() > 0.9
    assert np.percentile(errors[after & ~withheld], 95) < 2.0
    rates = tracker.motion(RESTING, STOP_S - 1.0)
    assert rates.end_s - rates.start_s == pytest.approx(0.1)


def test_forces_begin_to_follow_the_motion_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """That is when the heart is registered again."""
    begun_s, advance = [], BreathingTracker.advance

    def advanced(tracker: BreathingTracker, now_s: float) -> bool:
        begins = advance(tracker, now_s)
        begun_s.extend([now_s] * begins)
        return begins

    monkeypatch.setattr(BreathingTracker, "advance", advanced)
    tracker = follow(until_s=LEARNT_S).tracker
    assert tracker.model is not None
    assert len(begun_s) == 1
    assert 45.0 < begun_s[0] < LEARNT_S


@pytest.mark.parametrize("event", ["sigh", "disconnection", "cough"])
def test_a_pose_beyond_what_was_learnt_is_withheld_and_comes_back(event: str) -> None:
    """The event is a second one: beats in the first must not have taught that it is ordinary."""
    events = (("sigh" if event != "sigh" else "cough", 70.0), (event, 90.0))
    times, errors, withheld, tracker = follow(events, 125.0)
    breaths = world(events, until_s=125.0)[0].breaths
    beyond = (breaths.volume < -0.05) | (breaths.volume > BEYOND_VOLUME)
    beyond_s = breaths.t_s[beyond & (breaths.t_s > 90.0)]
    begin_s, end_s = float(beyond_s[0]), float(beyond_s[-1])
    late_s = times[(times > begin_s) & withheld][0] - begin_s
    assert late_s <= 0.3
    again = times > end_s + 3.0 * 60.0 / 14.0
    assert not withheld[again].any()
    served = (times > LEARNT_S) & ~withheld
    assert errors[served].max() < 5.0
    assert np.percentile(errors[again], 95) < 2.0
    frames = tracker.frames(np.arange(begin_s, end_s, 0.05))
    assert frames is not None
    assert not frames.usable.any()
    assert not np.isfinite(frames.features).all(axis=1).any()  # nor is anything learnt from them


def test_a_disconnection_before_the_motion_is_learnt_is_no_rest() -> None:
    times, errors, withheld, tracker = follow((("disconnection", 30.0),), 60.0)
    assert withheld[(times > 30.3) & (times < 42.0)].all()
    frames = tracker.frames(np.arange(30.1, 42.0, 0.1))
    assert frames is not None
    assert not frames.usable.any()
    served = (times > 16.0) & ~withheld
    assert errors[served].max() < 5.0
    assert (~withheld[times > 42.0 + 3.0 * 60.0 / 14.0]).any()


def test_the_latency_of_what_follows_the_breath_is_estimated() -> None:
    """The heart itself is late by its hysteresis: only a difference is known here."""
    found: list[list[BreathingRecord]] = [quiet()[-1], []]
    follow(late_s=0.2, log=found[1].append)
    soon, late = (records[-1].latency_s for records in found)
    assert soon is not None
    assert late is not None
    assert late - soon == pytest.approx(0.2, abs=0.06)
    held_out_mm = found[0][-1].held_out_mm
    assert held_out_mm is not None
    assert held_out_mm < 1.0
    assert found[0][-1].breaths is not None


def test_the_followed_breath_is_recorded_with_its_loop_and_what_beats_miss() -> None:
    (times, _, _, tracker), records = quiet()
    breath, (breathing, _) = records[-1].breath, world()
    assert breath is not None
    assert "breath" not in records[-1].described()
    model = breath.model
    shift_mm = breathing.mr_from_rest(breath.t_s.ravel())[1].reshape(*breath.t_s.shape, 3).mean(axis=0)
    course_mm = model.displacement_mm(breath.features - breath.rest)
    np.testing.assert_allclose(course_mm, -shift_mm @ model.along[3:], atol=1.0)
    assert np.ptp(course_mm) > 8.0
    residual_mm, sigma_mm = model.residuals_mm(breath.beats)
    assert len(breath.beats) == len(residual_mm)
    assert 0.6 < np.sqrt(np.mean((residual_mm / sigma_mm) ** 2)) < 1.3
    last_s = float(times[-1])
    now = tracker.status(last_s).breath
    assert now.state == BreathState.LOCKED
    assert 0.0 <= now.phase < 1.0
    moved_mm = -breathing.mr_from_rest(np.array([last_s]))[1][0] @ model.along[3:]
    assert now.displacement_mm == pytest.approx(moved_mm, abs=1.5)
    nothing = BreathingTracker(CENTER).status(5.0).breath
    assert nothing.state == UNFOLLOWED
    assert np.isnan([nothing.phase, nothing.displacement_mm]).all()


def test_breathing_that_is_deeper_for_good_is_learnt_again() -> None:
    """Withheld until five of its breaths gave a new scale, then the gate, then the motion."""
    times, errors, withheld, tracker = follow((("deepened", 80.0),), 160.0)
    assert withheld[(times > 86.0) & (times < 98.0)].mean() > 0.95
    gated = (times > 105.0) & (times < 125.0)
    assert 0.15 < (~withheld[gated]).mean() < 0.5
    assert tracker.model is not None
    late = times > 150.0
    assert (~withheld[late]).mean() > 0.95
    served = (times > LEARNT_S) & ~withheld
    assert errors[served].max() < 5.0
    assert np.percentile(errors[late & ~withheld], 95) < 2.0


def test_what_withholds_the_pose_is_said() -> None:
    _, recorded = world((("sigh", 70.0),))
    tracker, said, pushed = BreathingTracker(CENTER), [], 0
    for now_s in np.arange(0.5, 90.0, 0.5).tolist():
        due = int(np.searchsorted(recorded.t_s, min(now_s, 80.0), side="right"))
        for k in range(pushed, due):
            tracker.push(RespirationSample(float(recorded.t_s[k]), recorded.values[k]))
        pushed = due
        tracker.advance(now_s)
        said.append((now_s, tracker.status(now_s).reason, tracker.withheld(now_s)))
    reasons = [reason for _, reason, _ in said if reason is not None]
    order = list(dict.fromkeys(reasons))
    assert order == [
        BreathingReason.NO_BREATH.value,
        BreathingReason.LEARNING.value,
        BreathingReason.NOT_ORDINARY.value.format(what="deep breath"),
        BreathingReason.LOST.value,
    ]


def test_frames_in_a_gap_of_the_samples_are_not_used() -> None:
    _, recorded = world()
    tracker = BreathingTracker(CENTER)
    for t_s, values in zip(recorded.t_s.tolist(), recorded.values, strict=True):
        if t_s < 40.0 or t_s > 42.0:
            tracker.push(RespirationSample(t_s, values))
    tracker.advance(60.0)
    frames = tracker.frames(np.array([39.5, 40.1, 41.0, 41.9, 43.0]))
    assert frames is not None
    assert np.isfinite(frames.features).all(axis=1).tolist() == [True, False, False, False, True]


def test_a_beat_without_information_teaches_nothing() -> None:
    tracker = BreathingTracker(CENTER)
    nothing = replace(measured(np.zeros(6)), wrong_pose_log_ratio=0.0)
    frames = FrameBreathing(
        np.arange(3.0), np.ones((3, 4)), np.ones(3, np.bool_), np.zeros((3, 6)), np.zeros(3, np.bool_), False
    )
    tracker.add_beat(nothing, frames)
    assert tracker.model is None
