"""An intervention whose beats come from a hardware trigger, made of the true R peaks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded import tool_of

from dvf_ig.core import FloatArray, InvalidInputError, NoOverlapError, Scenario, TriggerTimes
from dvf_ig.guidance import Status
from dvf_ig.intake import describe, read_scenario, write_scenario
from dvf_ig.registration import target_errors_mm
from dvf_ig.replay import Replay, run_replay
from dvf_ig.replay.preconditions import require_heart_beats, tick_times

DELAY_S, STOPS_S = 0.03, 13.2


def with_trigger(scenario: Scenario, until_s: float = np.inf) -> Scenario:
    assert scenario.truth is not None
    fired_s = scenario.truth.r_peaks_s + DELAY_S
    return replace(scenario, ecg=TriggerTimes(fired_s[fired_s < until_s], DELAY_S))


def phase_errors(replay: Replay) -> FloatArray:
    """Errors of the phase where it is valid, in shares of RR."""
    assert replay.scenario.truth is not None
    peaks, track = replay.scenario.truth.r_peaks_s, replay.ticks.phase
    beat = np.searchsorted(peaks, track.t_s, side="right") - 1
    known = track.valid & (beat >= 0) & (beat < len(peaks) - 1)
    at = beat[known]
    true = (track.t_s[known] - peaks[at]) / (peaks[at + 1] - peaks[at])
    return np.asarray(np.abs((track.phi[known] - true + 0.5) % 1.0 - 0.5))


def first_tre_mm(replay: Replay) -> float:
    """Mean registration error of the first pose in use, a registration."""
    truth = replay.scenario.truth
    assert truth is not None
    return float(
        target_errors_mm(replay.poses[0][1], truth.mr_from_tracker_at(0.0), truth.targets.points).mean()
    )


def test_a_trigger_registers_and_guides_as_an_ecg_does_until_it_stops(
    scenario: Scenario, replay: Replay
) -> None:
    stopped = run_replay(with_trigger(scenario, STOPS_S), model=replay.heart.model, seed=0)
    # a beat whose phase differs by some milliseconds may begin the count of consistent ones anew: two beats
    ours, theirs = (run.history.updates[0].from_s for run in (stopped, replay))
    assert ours == pytest.approx(theirs, abs=1.7)
    assert first_tre_mm(stopped) == pytest.approx(first_tre_mm(replay), abs=0.1)
    errors = phase_errors(stopped)
    assert errors.mean() < 0.01
    assert np.quantile(errors, 0.95) < 0.03
    t_s, force_n = stopped.ticks.t_s, np.linalg.norm(stopped.ticks.force_n, axis=1)
    with_ecg_n = np.linalg.norm(replay.ticks.force_n, axis=1)
    lost = t_s > STOPS_S + 1.5
    assert with_ecg_n[replay.ticks.t_s > STOPS_S + 1.5].max() > 0.1
    assert force_n[~lost].max() > 0.1
    walls = stopped.ticks.status == int(Status.NO_PHASE)
    assert force_n[lost & walls].max() > 0.1, "the wall of the worst phase stays while the pose is confirmed"
    assert not (stopped.ticks.status[lost] == int(Status.OK)).any()
    assert not stopped.ticks.phase.valid[lost].any()


def test_ticks_go_on_where_a_trigger_is_silent(scenario: Scenario) -> None:
    silent = replace(scenario, ecg=TriggerTimes(np.array([3.0, 3.8, 4.6, 5.4])))
    t_s = tick_times(silent)
    assert t_s[0] == tool_of(scenario).t_s[0]
    assert t_s[-1] > tool_of(scenario).t_s[-1] - 0.01
    with pytest.raises(InvalidInputError, match="the trigger gives 4 beats of 4 pulses"):
        require_heart_beats([0] * 4, silent)
    with pytest.raises(NoOverlapError, match=r"trigger .* share less than a second"):
        tick_times(replace(scenario, ecg=TriggerTimes(np.array([1e4, 1e4 + 2.0]))))


def test_a_folder_keeps_the_trigger(brief: Scenario, tmp_path: Path) -> None:
    triggered = with_trigger(brief)
    write_scenario(triggered, tmp_path / "s")
    back = read_scenario(tmp_path / "s").ecg
    assert isinstance(back, TriggerTimes)
    assert isinstance(triggered.ecg, TriggerTimes)
    np.testing.assert_array_equal(back.t_s, triggered.ecg.t_s)
    assert back.delay_s == DELAY_S
    assert describe(str(tmp_path / "s")).facts["ecg"]["pulses"] == len(back)
