"""A hardware trigger as the source of beats."""

from pathlib import Path

import numpy as np
import pytest

from dvf_ig.cardiac import TriggerDetector, phase_from_peaks
from dvf_ig.cardiac.phase_tracking import trigger_peaks
from dvf_ig.core import FloatArray, IntArray, InvalidInputError, PhaseState, TriggerTimes
from dvf_ig.io import read_triggers, write_triggers


def test_r_lies_before_the_pulse_that_makes_it_known() -> None:
    peaks, changes = trigger_peaks(TriggerTimes(np.array([1.0, 1.8]), 0.03))
    assert [p.t_s for p in peaks] == pytest.approx([0.97, 1.77])
    assert [p.detected_at_s for p in peaks] == [1.0, 1.8]
    assert changes == ()


@pytest.mark.parametrize(
    ("times", "delay_s", "message"),
    [
        ([], 0.0, "at least 1"),
        ([1.0, np.nan], 0.0, "finite"),
        ([1.0, 0.5], 0.0, "order the pulses"),
        ([1.0, 2.0], 20.0, "is it in ms"),
        ([1.0, 2.0], -0.1, "needed 0 to"),
    ],
)
def test_refusals(times: list[float], delay_s: float, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        TriggerTimes(np.array(times), delay_s)


def test_a_live_pulse_does_not_go_back() -> None:
    detector = TriggerDetector()
    detector.push(2.0)
    with pytest.raises(InvalidInputError, match="feed them in order"):
        detector.push(1.9)
    with pytest.raises(InvalidInputError, match="is it in ms"):
        TriggerDetector(30.0)


# ------------------------------------------------------------------ what goes wrong with triggers

RR_S, UNTIL_S = 0.8, 30.0
STEADY = 0.4 + RR_S * np.arange(36)


def states(pulses_s: FloatArray, delay_s: float = 0.02) -> tuple[FloatArray, FloatArray, IntArray]:
    """Times, phase and state from pulses that fire `delay_s` after the R peaks."""
    peaks, changes = trigger_peaks(TriggerTimes(np.sort(pulses_s) + delay_s, delay_s))
    t_s = np.arange(0.0, UNTIL_S, 0.01)
    track = phase_from_peaks(peaks, changes, t_s)
    return t_s, track.phi, track.state


def locked(t_s: FloatArray, state: IntArray, from_s: float, until_s: float) -> bool:
    return bool((state[(t_s > from_s) & (t_s < until_s)] == PhaseState.LOCKED).all())


def wrong_while_locked(t_s: FloatArray, phi: FloatArray, state: IntArray) -> float:
    """Largest error of a phase that may be used."""
    error = np.abs((phi - (t_s - 0.4) / RR_S + 0.5) % 1.0 - 0.5)
    return float(error[state == PhaseState.LOCKED].max())


def test_the_phase_of_a_steady_trigger_is_right() -> None:
    t_s, phi, state = states(STEADY)
    assert locked(t_s, state, 5.0, 28.5)
    assert wrong_while_locked(t_s, phi, state) < 1e-9


def test_a_trigger_that_stops_is_lost() -> None:
    t_s, _, state = states(STEADY[STEADY < 15.0])
    last_s = STEADY[STEADY < 15.0][-1]
    assert locked(t_s, state, 5.0, last_s + 1.3 * RR_S)
    assert (state[t_s > last_s + 1.45 * RR_S] == PhaseState.LOST).all()


def test_one_missing_pulse_invalidates_until_beats_are_regular_again() -> None:
    t_s, phi, state = states(np.delete(STEADY, 18))
    missing_s = STEADY[18]
    assert not locked(t_s, state, missing_s + 0.4 * RR_S, missing_s + 0.9 * RR_S)
    assert locked(t_s, state, missing_s + 8 * RR_S, 28.5)
    assert wrong_while_locked(t_s, phi, state) < 0.005


@pytest.mark.parametrize("after_s", [0.0, 0.001, 0.02, 0.15, 0.24])
def test_a_double_pulse_invalidates_at_once(after_s: float) -> None:
    """Of two pulses too close to be beats nobody knows which is R; either edge of a bounce counts as such."""
    double_s = STEADY[18] + after_s
    t_s, phi, state = states(np.append(STEADY, double_s))
    assert not (state[(t_s >= double_s + 0.03) & (t_s < double_s + 3.5 * RR_S)] == PhaseState.LOCKED).any()
    assert locked(t_s, state, double_s + 8 * RR_S, 28.5)
    assert wrong_while_locked(t_s, phi, state) < 0.005


@pytest.mark.parametrize("share", [0.35, 0.5, 0.75])
def test_an_extra_pulse_in_mid_beat_invalidates_the_phase(share: float) -> None:
    """As from a T wave that is taken for an R wave."""
    extra_s = STEADY[18] + share * RR_S
    t_s, _, state = states(np.append(STEADY, extra_s))
    inside = (t_s > extra_s + 0.03) & (t_s < STEADY[19])
    assert not (state[inside] == PhaseState.LOCKED).any()


def test_both_edges_of_every_pulse_give_no_phase() -> None:
    _, _, state = states(np.concatenate([STEADY, STEADY + 0.05]))
    assert not (state == PhaseState.LOCKED).any()


# ------------------------------------------------------------------ files


def test_file_with_and_without_header(tmp_path: Path) -> None:
    path = tmp_path / "pulses.csv"
    path.write_text("0.5\n1.25\n\n2.0\n")
    assert read_triggers(path).t_s.tolist() == [0.5, 1.25, 2.0]
    assert read_triggers(path, 0.03).delay_s == 0.03
    path.write_text("time s\n0.5,\n")
    assert read_triggers(path).t_s.tolist() == [0.5]


def test_a_trigger_comes_back_digit_for_digit(tmp_path: Path) -> None:
    trigger = TriggerTimes(np.cumsum(np.random.default_rng(1).uniform(0.6, 1.0, 30)), 0.0123)
    write_triggers(trigger, tmp_path / "t.csv")
    back = read_triggers(tmp_path / "t.csv")
    np.testing.assert_array_equal(back.t_s, trigger.t_s)
    assert back.delay_s == trigger.delay_s
    assert read_triggers(tmp_path / "t.csv", 0.02).delay_s == 0.02


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no trigger"),
        ("t\n", "no trigger"),
        ("1\nx\n", "line 2"),
        ("# delay_s soon\n1\n", "line 1: 'soon'"),
        ("2\n1\n", "order the pulses"),
        ("# delay_s 30\n1\n", "is it in ms"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "pulses.csv"
    path.write_text(text)
    with pytest.raises(InvalidInputError, match=message):
        read_triggers(path)
