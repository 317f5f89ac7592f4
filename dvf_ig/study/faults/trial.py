"""One trial of the study: a row of the table at one severity with one seed."""

from math import isfinite

from dvf_ig.study.trials import Line, Settings

from .catalogue import ROWS, SEVERITIES
from .rows.row import Row, Severity
from .servo_trial import ServoFault, run_servo_fault
from .session_trial import SessionFault, run_session_fault
from .start_trial import StartFault, refused
from .trace import judge

CASES = SEVERITIES * len(ROWS)
"""Rows times severities: trials of one seed."""


def case_of(number: int) -> tuple[int, Row, Severity]:
    """Seed, row and severity of a trial; those of one seed follow one another."""
    seed, case = divmod(number, CASES)
    row = ROWS[case // SEVERITIES]
    return seed, row, row.severities[case % SEVERITIES]


def trial_numbers(first_seed: int, seeds: int) -> range:
    """Numbers of the trials of consecutive seeds."""
    return range(first_seed * CASES, (first_seed + seeds) * CASES)


def fault_trial(settings: Settings, number: int) -> Line:
    """Run one trial.

    Args:
        settings: none.
        number: see `case_of`.
    """
    seed, row, severity = case_of(number)
    head = {"fault_seed": seed, "row": row.name, "severity": severity.label, "limit_s": severity.limit_s}
    if isinstance(severity.fault, StartFault):
        found = refused(severity.fault.start, seed)
        return {
            **head,
            "detected": found,
            "detected_s": 0.0 if found else None,
            "early": refused(severity.fault.clean, seed),
            "found": [],
        }
    return {**head, **_judged(row, severity, severity.fault, seed)}


def _judged(row: Row, severity: Severity, fault: SessionFault | ServoFault, seed: int) -> Line:
    if isinstance(fault, SessionFault):
        session = run_session_fault(fault, seed)
        trace, begin_s, end_s, rearm_s = session.trace, session.begin_s, session.end_s, session.rearm_s
    else:
        servo = run_servo_fault(fault, seed)
        trace, begin_s, end_s, rearm_s = servo.trace, servo.begin_s, servo.end_s, servo.rearm_s
    done = judge(
        trace,
        row.hazards,
        begin_s=begin_s,
        end_s=end_s,
        limit_s=severity.limit_s,
        rearm_s=rearm_s,
        by_pose=isinstance(fault, SessionFault) and fault.by_pose,
    )
    stays = isinstance(fault, ServoFault) and fault.restarts
    return {
        "detected": done.detected_s <= severity.limit_s + 1e-9,
        "detected_s": done.detected_s if isfinite(done.detected_s) else None,
        "early": done.early,
        "found": [str(hazard.name) for hazard in done.found],
        "error_n": done.error_n,
        "error_s": done.error_s,
        "latched": done.latched,
        "recovery_s": done.recovery_s if done.recovery_s is None or isfinite(done.recovery_s) else None,
        "recovered": done.recovered if not stays else done.recovery_s is not None and not done.recovered,
    }
