"""Severities of a fault in one stream of a session: tool poses, ultrasound frames, or the ECG."""

from dvf_ig.study.faults.injection.fault import ArrivalsChange, Fault
from dvf_ig.study.faults.session_trial import SessionFault

from .delays import PHASE_BACK_S, POSE_BACK_S, SLOW_STEP_S, STEP_S
from .row import Severity


def tool_fault(label: str, change: ArrivalsChange, seconds: float, limit_s: float) -> Severity:
    """What happens to the tool's poses, for so many seconds."""
    return Severity(label, SessionFault(Fault(tool=change), seconds), limit_s)


def frames_fault(label: str, change: ArrivalsChange, seconds: float, limit_s: float) -> Severity:
    """What happens to ultrasound frames; the pose is back only after another registration."""
    fault = SessionFault(Fault(frames=change), seconds, POSE_BACK_S, state_step_s(limit_s))
    return Severity(label, fault, limit_s)


def ecg_fault(
    label: str, fault: Fault, seconds: float, limit_s: float, back_s: float = PHASE_BACK_S
) -> Severity:
    """What happens to the ECG, or to the heart's rhythm; `back_s` passes until the phase is known again."""
    return Severity(label, SessionFault(fault, seconds, back_s, state_step_s(limit_s)), limit_s)


def state_step_s(limit_s: float) -> float:
    """Time between two states of a trial: fine enough for the limit."""
    return STEP_S if limit_s < 1.0 else SLOW_STEP_S


def three(severities: list[Severity]) -> tuple[Severity, Severity, Severity]:
    """The three severities of a row, the least first."""
    first, second, third = severities
    return first, second, third
