"""Rows of the table whose faults are in the tool's poses: late, lost, frozen, not finite, out of volume."""

from dvf_ig.guidance import Hazard
from dvf_ig.study.faults.injection.arrivals import (
    frozen,
    late,
    missing,
    not_finite,
    not_tracked,
    repeated,
    scaled,
    to_and_fro,
)
from dvf_ig.study.faults.injection.fault import Fault
from dvf_ig.study.faults.injection.motion import leaving
from dvf_ig.study.faults.session_trial import SessionFault

from .delays import FRAME_S, LATE_FOR_S, STEP_S, TOO_OLD_S, TOOL_ARRIVES_S
from .row import Row, Severity
from .severity import three, tool_fault

_LOST = Hazard.TOOL_LOST | Hazard.STALE_TOOL
_GAPS = (("2 frames", 0.02), ("20 frames", 0.2), ("1.5 s", 1.5))

TOOL_ROWS: tuple[Row, ...] = (
    Row(
        "stale tracking",
        Hazard.STALE_TOOL,
        "age beyond the smaller of 2.5 frames, above the usual latency, and 50 ms",
        three([tool_fault(f"no pose for {name}", missing, s, TOO_OLD_S) for name, s in _GAPS]),
    ),
    Row(
        "line of sight lost",
        _LOST,
        "predicted until 2.5 frames, above the usual latency, after the last pose that was tracked",
        three([tool_fault(f"status not OK for {name}", not_tracked, s, TOO_OLD_S) for name, s in _GAPS]),
    ),
    Row(
        "tool frozen",
        Hazard.TOOL_FROZEN,
        "the fifth pose in a row that is the same: four frames after the last fresh one, and its arrival",
        three(
            [
                tool_fault(f"frozen for {name}", frozen, s, 4 * FRAME_S + TOOL_ARRIVES_S + STEP_S)
                for name, s in (("5 frames", 0.05), ("20 frames", 0.2), ("1.5 s", 1.5))
            ]
        ),
    ),
    Row(
        "latency jump",
        Hazard.LATENCY_JUMP | Hazard.STALE_TOOL,
        "age 15 ms above its median in 3 of 5 poses, at 30 mm/s: three frames, the jump, the arrival",
        three(
            [
                tool_fault(
                    f"{1000 * by:g} ms later",
                    late(by),
                    LATE_FOR_S,
                    3 * FRAME_S + by + TOOL_ARRIVES_S + STEP_S,
                )
                for by in (0.018, 0.040, 0.100)
            ]
        ),
    ),
    Row(
        "duplicate or reordered: tool",
        Hazard.REORDERED_STAMPS,
        "more than 10 of the last 100 poses",
        three(
            [
                tool_fault(f"{share:.0%} come twice", repeated(share), 2.0, 100 * FRAME_S + TOOL_ARRIVES_S)
                for share in (0.12, 0.3, 0.5)
            ]
        ),
    ),
    Row(
        "two programs send the tool",
        Hazard.TOOL_CONTRADICTED,
        "four steps back: five poses, and their arrival",
        three(
            [
                tool_fault(f"{by:g} mm apart", to_and_fro(by), 0.5, 5 * FRAME_S + TOOL_ARRIVES_S + STEP_S)
                for by in (4.0, 15.0, 60.0)
            ]
        ),
    ),
    Row(
        "NaN or Inf: tool pose",
        Hazard.NOT_FINITE,
        "the first such pose: one frame, and its arrival",
        three(
            [
                tool_fault(f"NaN in {name}", not_finite, s, FRAME_S + TOOL_ARRIVES_S + STEP_S)
                for name, s in (("1 pose", 0.01), ("5 poses", 0.05), ("50 poses", 0.5))
            ]
        ),
    ),
    Row(
        "shear or scale: tool pose",
        _LOST,
        "rejected at 1e-3; as a pose that was not tracked",
        three(
            [
                tool_fault(f"{100 * (by - 1.0):.2g} % of scale", scaled(by), 0.1, TOO_OLD_S)
                for by in (1.0006, 1.01, 1.2)
            ]
        ),
    ),
    Row(
        "out of volume",
        Hazard.OUT_OF_VOLUME,
        "two frames, the arrival, and 8 ms for 0.24 mm of the tracker's noise at 30 mm/s",
        three(
            [
                Severity(
                    f"{by:g} mm beyond the box",
                    SessionFault(Fault(tip=leaving(by)), 0.6),
                    2 * FRAME_S + TOOL_ARRIVES_S + 0.008,
                )
                for by in (0.5, 2.0, 8.0)
            ]
        ),
    ),
)
