"""Rows of the table whose faults are in the clocks of tool, ultrasound and ECG: drift, ahead, back."""

from collections.abc import Callable

from dvf_ig.guidance import Hazard
from dvf_ig.study.faults.injection.arrivals import drifting, stamped_back
from dvf_ig.study.faults.injection.fault import ArrivalsChange, Fault
from dvf_ig.study.faults.session_trial import SessionFault

from .delays import FRAME_ARRIVES_S, FRAME_S, PACKET_S, TOO_OLD_S, TOOL_ARRIVES_S, ULTRASOUND_FRAME_S
from .row import Row, Severity
from .severity import ecg_fault, frames_fault, three, tool_fault


def _drift_row(stream: str, faulty: Callable[[ArrivalsChange], Fault]) -> Row:
    """A clock that gains time."""
    skew = (("150 ppm fast", 150e-6), ("150 ppm slow", -150e-6), ("400 ppm fast", 400e-6))
    return Row(
        f"clock drift: {stream}",
        Hazard.CLOCK_SKEW,
        "100 ppm over 60 s are 6 ms; that at the clock's rate, and three blocks of 2 s",
        three([_drift(label, faulty(drifting(rate)), rate) for label, rate in skew]),
    )


def _drift(label: str, fault: Fault, rate: float) -> Severity:
    """The fault lasts until it must have been found, and a little longer."""
    limit_s = _drift_limit_s(rate)
    return Severity(label, SessionFault(fault, limit_s + 2.0, 2.0, 0.01), limit_s)


def _drift_limit_s(rate: float) -> float:
    """6 ms (100 ppm over 60 s) at this rate, and three blocks of 2 s of which the least latency is taken."""
    return 0.006 / abs(rate) + 6.0


CLOCK_ROWS: tuple[Row, ...] = (
    _drift_row("tool", lambda change: Fault(tool=change)),
    _drift_row("ultrasound", lambda change: Fault(frames=change)),
    _drift_row("ECG", lambda change: Fault(ecg=change)),
    Row(
        "clock ahead: tool",
        Hazard.CLOCK_SKEW,
        "the first pose stamped more than 5 ms after its arrival: one frame, and its arrival",
        three(
            [
                tool_fault(
                    f"{1000 * by:g} ms ahead", stamped_back(-by - 0.003), 0.5, FRAME_S + TOOL_ARRIVES_S
                )
                for by in (0.007, 0.1, 10.0)
            ]
        ),
    ),
    Row(
        "clock goes back: tool",
        Hazard.CLOCK_BACKWARDS | Hazard.STALE_TOOL,
        "its poses are refused: age beyond 2.5 frames",
        three([tool_fault(f"{by:g} s back", stamped_back(by), 0.5, TOO_OLD_S) for by in (0.15, 1.0, 10.0)]),
    ),
    Row(
        "clock goes back: ultrasound",
        Hazard.CLOCK_BACKWARDS,
        "the first frame stamped back: one frame, and its arrival",
        three(
            [
                frames_fault(f"{by:g} s back", stamped_back(by), 0.6, ULTRASOUND_FRAME_S + FRAME_ARRIVES_S)
                for by in (0.3, 1.0, 10.0)
            ]
        ),
    ),
    Row(
        "clock goes back: ECG",
        Hazard.CLOCK_BACKWARDS,
        "the first packet stamped back: 20 ms, and its arrival",
        three(
            [
                ecg_fault(f"{by:g} s back", Fault(ecg=stamped_back(by)), 0.6, 0.020 + PACKET_S)
                for by in (0.15, 1.0, 10.0)
            ]
        ),
    ),
)
