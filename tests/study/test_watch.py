"""The study of the watch, on beats of a heart whose pose is known."""

from functools import cache

import numpy as np
import pytest
from known_patient import known_beat

from dvf_ig.core import Rigid, Scenario, mean_displacement_mm
from dvf_ig.registration import PoseEstimate
from dvf_ig.replay import Replay
from dvf_ig.study.driver import Line
from dvf_ig.study.statistics import poisson_rate, share_over_hearts
from dvf_ig.study.watch.beats import (
    FIRST_ONSET,
    DisplacedBeat,
    WatchedBeat,
    WatchedRecording,
    beats_until_found,
    moved,
    watch_recording,
)
from dvf_ig.study.watch.study import measured, summarise_watch

CENTER = np.array([10.0, -20.0, 30.0])
HOME = Rigid.from_rotation_vector([0.2, -0.1, 0.4], [5.0, 6.0, -7.0], "mr", "tracker")
RR_S = 0.8


@cache
def quiet_line() -> Line:
    """Measurements of a recording whose beats raise no alarm."""
    return measured(recording(70), 1001)


def recording(beats: int, alarms: tuple[str, ...] = ()) -> WatchedRecording:
    """A still heart, whose pose is known exactly and stated as known to 0.3 mm."""
    held = PoseEstimate(HOME, 0.3**2 * np.eye(6), CENTER, 0.3**2 * np.eye(6))
    watched = []
    for k in range(beats):
        slices = known_beat(RR_S * k, RR_S * (k + 1), HOME)
        watched.append(WatchedBeat(slices, slices.evaluate_beat(HOME, CENTER, in_use=True), held, 0.2))
    return WatchedRecording(tuple(watched), alarms, beats * RR_S, 0.0)


def test_a_displaced_beat_says_what_a_beat_of_the_displaced_heart_says() -> None:
    shift = np.array([3.0, -2.0, 1.5])
    there, tested = moved(HOME, shift), HOME.perturbed_left([0.02, 0.01, -0.03], [1.0, 0.5, -0.7], CENTER)
    found = DisplacedBeat(known_beat(0.0, RR_S, HOME), shift).evaluate_beat(tested, CENTER, in_use=True)
    real = known_beat(0.0, RR_S, there).evaluate_beat(tested, CENTER, in_use=True)
    assert found is not None
    assert mean_displacement_mm(found.measurement.best, there, CENTER) < 1e-9
    assert found.measurement.pose is tested
    np.testing.assert_allclose(
        found.measurement.offset_information_mm, real.measurement.offset_information_mm, atol=1e-9
    )
    assert found.measurement.moved_mm == pytest.approx(real.measurement.moved_mm)


def test_a_trial_counts_beats_until_a_shift_is_found_and_how_far_a_drift_is_followed() -> None:
    line = quiet_line()
    assert line["beats"] == 70
    assert max(line["statistic"]) == 0.0
    assert len(line["shifts"]["8"]) == len(line["shifts"]["4"]) == 10
    assert set(line["shifts"]["8"]) == {1}
    assert all(1 <= beats <= 3 for beats in line["shifts"]["4"])
    lags = [line["drifts"][rate]["lag_mm"] for rate in ("1", "3", "10")]
    assert 0.0 < lags[0] < lags[1] < lags[2] < 2.0


@pytest.mark.usefixtures("known_registrations")
def test_beats_of_a_recording_are_displaced_when_its_session_has_ended(
    scenario: Scenario, replay: Replay, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dvf_ig.study.watch.beats.build_heart", lambda *_: replay.heart)
    watched = watch_recording(scenario, 0)
    assert len(watched.beats) > FIRST_ONSET
    assert watched.alarms == ()
    found = beats_until_found(watched, FIRST_ONSET, np.array([12.0, 0.0, 0.0]))
    assert found is not None
    assert found <= 3


def test_a_summary_counts_alarms_over_the_time_and_shares_over_hearts() -> None:
    quiet, loud = quiet_line(), measured(recording(70, alarms=("moved", "moved")), 2)
    refused = {"seed": 3, "refused": "no pose"}
    found = summarise_watch([{"seed": 1, **quiet}, {"seed": 2, **loud}, refused])
    assert (found.hearts, found.failed, found.beats) == (3, 1, 140)
    assert found.alarms == ("moved", "moved")
    assert found.alarms_per_hour.value == pytest.approx(2 / (140 * RR_S / 3600))
    assert found.bound_covers.value == 1.0
    assert found.shifts[1].within["1"].value == 1.0
    assert found.drifts[2].mm_per_min == 10.0


def test_the_interval_of_a_rate_is_the_exact_one() -> None:
    """Garwood's table: 0 events up to 3.69, 3 events from 0.62 to 8.77."""
    none, three = poisson_rate(0, 1.0), poisson_rate(3, 2.0)
    assert none.low == 0.0
    assert none.high == pytest.approx(3.689, abs=1e-3)
    assert three.low == pytest.approx(0.3093, abs=1e-3)
    assert three.high == pytest.approx(4.3837, abs=1e-3)
    assert poisson_rate(0, 0.0).value is None


def test_a_share_varies_with_the_hearts_and_not_with_their_trials() -> None:
    alike = share_over_hearts([[True] * 50 + [False] * 50] * 10)
    unlike = share_over_hearts([[True] * 100] * 5 + [[False] * 100] * 5)
    assert alike.value == unlike.value == 0.5
    assert (alike.low, alike.high) == (0.5, 0.5)
    assert unlike.low is not None
    assert unlike.low < 0.3
