"""Trials of the study of faults: found within the limit, judged as the rule says, none without a fault."""

import numpy as np
import pytest

from dvf_ig.guidance import Hazard, SupervisorState
from dvf_ig.study.driver import Line
from dvf_ig.study.faults import clean
from dvf_ig.study.faults.catalogue import ROWS, SEVERITIES
from dvf_ig.study.faults.clean import AlarmCount, clean_trial
from dvf_ig.study.faults.session_trial import TrialTrace, judge
from dvf_ig.study.faults.study import (
    CASES,
    case_of,
    fault_trial,
    faults_page,
    summarise_clean,
    summarise_faults,
    table_counts,
    trial_numbers,
)

SEED = 101
OK, DEGRADED, FADE, LATCHED = SupervisorState
QUICK = [
    # row, severity: one of each kind of disturbance; tests/session has every hazard of the streams
    ("line of sight lost", 2),
    ("ECG lead-off", 0),
    ("clock ahead: tool", 0),
    ("clock goes back: ultrasound", 0),
    ("device lost", 0),
    ("session silent", 0),
    ("force jump", 0),
    ("missed deadlines", 0),
    ("watchdog", 0),
    ("energy", 0),
    ("LPS/RAS", 0),
    ("probe calibration", 0),
    ("shear or scale: start pose", 0),
    ("model of another patient", 1),
]


def line_of(name: str, severity: int, seed: int = SEED) -> Line:
    row = next(k for k, row in enumerate(ROWS) if row.name == name)
    return fault_trial({}, seed * CASES + SEVERITIES * row + severity)


def test_numbers_of_trials_name_seed_row_and_severity() -> None:
    numbers = trial_numbers(5, 2)
    assert {len(row.severities) for row in ROWS} == {SEVERITIES}
    assert len(numbers) == 2 * SEVERITIES * len(ROWS)
    assert case_of(numbers[0])[0] == 5
    assert case_of(numbers[-1]) == (6, ROWS[-1], ROWS[-1].severities[2])


@pytest.fixture(scope="module")
def lines() -> list[Line]:
    return [line_of(name, severity) for name, severity in QUICK]


def test_the_least_severity_is_detected_within_its_limit_and_nothing_without_it(lines: list[Line]) -> None:
    for line in lines:
        assert line["detected"], line
        assert not line["early"], line
        assert line.get("recovered", True), line
        assert (line.get("error_s") or 0.0) <= 0.002, line


def test_the_page_and_the_summary_tell_a_miss(lines: list[Line]) -> None:
    rows = summarise_faults(lines)
    assert table_counts(rows) == {"hazards": len(QUICK), "detected": len(QUICK), "missed": 0}
    missed = [{**lines[0], "detected": False, "detected_s": None}, *lines[1:]]
    counts = {**table_counts(summarise_faults(missed)), "false_alarms": 0}
    assert counts["missed"] == 1
    assert "class='verdict bad'" in faults_page(summarise_faults(missed), counts, {}, 8.0)
    counts = {**table_counts(rows), "false_alarms": 1}
    assert "class='verdict good'" in faults_page(rows, counts, {"TOOL_LOST": 1}, 8.0)


def test_a_minute_without_a_fault_raises_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clean, "SECONDS", 30.0)
    line = clean_trial({}, SEED)
    assert line["false_alarms"] == 0, line
    assert line["served_share"] > 0.5
    assert set(line["session"]) <= {"POSE_MOVING"}
    together = summarise_clean([line, {**line, "false_alarms": 2, "servo": {"ENERGY": 2}}])
    assert (together.false_alarms, together.raised["ENERGY"]) == (2, 2)


def test_alarms_are_counted_from_the_first_full_force_on_each_time_they_begin() -> None:
    count = AlarmCount()
    lost, moving = int(Hazard.TOOL_LOST), int(Hazard.POSE_MOVING)
    for hazards, state in (
        (int(Hazard.NO_POSE), FADE),
        (0, OK),
        (lost, FADE),
        (lost | moving, FADE),
        (0, OK),
        (lost, FADE),
    ):
        count.add(hazards, state)
    assert count.counts == {"TOOL_LOST": 2, "POSE_MOVING": 1}
    assert count.alarms == 2


# ------------------------------------------------------------------ what is judged


def trace(hazard: Hazard, from_s: float, until_s: float, *, gone_s: float, state: int = FADE) -> TrialTrace:
    """A hazard between two times, and a force that goes `gone_s` after it began."""
    t = np.arange(0.0, 5.0, 0.001)
    active = (t >= from_s) & (t < until_s)
    withheld = (t >= from_s + gone_s) & (t < until_s)
    return TrialTrace(
        t,
        np.where(active, int(hazard), 0),
        np.where(active, state, OK),
        np.where(withheld, 0.0, 0.5),
        np.full(len(t), 0.5),
        np.zeros(len(t)),
    )


def test_a_force_that_stays_too_long_is_given_in_error() -> None:
    given = trace(Hazard.TOOL_LOST, 1.01, 1.9, gone_s=0.4)
    done = judge(given, Hazard.TOOL_LOST, begin_s=1.0, end_s=1.9, limit_s=0.02, rearm_s=3.0)
    assert done.detected_s == pytest.approx(0.01)
    assert done.error_n == 0.5
    assert done.error_s == pytest.approx(1.01 + 0.4 - (1.0 + 0.02 + 0.25), abs=0.002)
    in_time = trace(Hazard.TOOL_LOST, 1.01, 1.9, gone_s=0.2)
    done = judge(in_time, Hazard.TOOL_LOST, begin_s=1.0, end_s=1.9, limit_s=0.02, rearm_s=3.0)
    assert (done.error_n, done.error_s) == (0.0, 0.0)
    assert done.recovered
    assert done.recovery_s == pytest.approx(0.0, abs=1e-9)


def test_a_hazard_that_should_latch_and_does_not_is_no_recovery() -> None:
    long = trace(Hazard.TOOL_LOST, 1.0, 3.0, gone_s=0.25)
    done = judge(long, Hazard.TOOL_LOST, begin_s=1.0, end_s=3.0, limit_s=0.02, rearm_s=4.0)
    assert done.latch_due
    assert not done.latched
    assert not done.recovered
    latched = trace(Hazard.TOOL_LOST, 1.0, 3.0, gone_s=0.25, state=LATCHED)
    done = judge(latched, Hazard.TOOL_LOST, begin_s=1.0, end_s=3.0, limit_s=0.02, rearm_s=2.9)
    assert done.recovered
    assert done.recovery_s == pytest.approx(0.1, abs=0.002)


def test_a_fault_that_is_never_found_is_missed_and_what_came_before_is_early() -> None:
    other = trace(Hazard.NO_PHASE, 0.2, 0.4, gone_s=0.1)
    done = judge(other, Hazard.TOOL_LOST, begin_s=1.0, end_s=2.0, limit_s=0.02, rearm_s=3.0)
    assert done.detected_s == np.inf
    assert done.early
    assert done.error_n is None
