"""Rows of the table whose faults are in the streams of a session: tool, ultrasound, ECG, clocks, patient."""

from collections.abc import Callable

from dvf_ig.guidance import Hazard

from .injection import (
    ArrivalsChange,
    Fault,
    drifting,
    early_beats,
    fibrillation,
    flat,
    frozen,
    late,
    leaving,
    mains_hum,
    missing,
    moved_by,
    not_finite,
    not_tracked,
    registered_off,
    repeated,
    scaled,
    stamped_back,
    unplugged,
    without_image,
)
from .row import Row, Severity
from .session_trial import WARM_UP_STEP_S, SessionFault

STEP_S, SLOW_STEP_S = 0.001, 0.004
"""States are a millisecond apart, which each limit includes; where it is a second or more, four."""
FRAME_S, TOOL_ARRIVES_S, FRAME_ARRIVES_S = 0.010, 0.007, 0.035
"""The tool's frame; a pose or an ultrasound frame has arrived so long after its stamp, jitter included."""
ULTRASOUND_FRAME_S = 1.0 / 12.0
PACKET_S = 0.028
"""A packet of the ECG has arrived so long after its first sample."""
LATE_FOR_S = 0.15
"""Of a jump: with half of the last 32 poses it is the usual latency, over which the tip is predicted."""
USUAL_LATE_S = 0.0045
"""Median latency of the tool's poses, and the jitter of their stamps."""
TOO_OLD_S = 2.5 * FRAME_S + USUAL_LATE_S + STEP_S
BEAT_S = 0.90
"""Longest interval at 72 beats/min with the study's variability."""
DETECTED_S = 0.25
"""An R peak is known so long after it: 0.139 s in 95 % (docs/theory/cardiac.md), and the packet's arrival."""
LOST_S = 1.35 * BEAT_S + DETECTED_S
PHASE_BACK_S = 12.0
POSE_BACK_S = 16.0
REGULAR_S = 45.0
"""The operator waits so long for the phase, for a registration that beats confirm, and for the phase after
fibrillation: forecasts that failed are forgotten by 5 % a beat."""


def _tool(label: str, change: ArrivalsChange, seconds: float, limit_s: float) -> Severity:
    return Severity(label, SessionFault(Fault(tool=change), seconds), limit_s)


def _frames(label: str, change: ArrivalsChange, seconds: float, limit_s: float) -> Severity:
    step_s = STEP_S if limit_s < 1.0 else SLOW_STEP_S
    return Severity(label, SessionFault(Fault(frames=change), seconds, POSE_BACK_S, step_s), limit_s)


def _ecg(label: str, change: ArrivalsChange, seconds: float, limit_s: float) -> Severity:
    step_s = STEP_S if limit_s < 1.0 else SLOW_STEP_S
    return Severity(label, SessionFault(Fault(ecg=change), seconds, PHASE_BACK_S, step_s), limit_s)


def _drift(label: str, faulty: Callable[[ArrivalsChange], Fault], rate: float) -> Severity:
    """A clock that gains time; the fault lasts until it must have been found, and a little longer."""
    limit_s = _drift_limit_s(rate)
    return Severity(label, SessionFault(faulty(drifting(rate)), limit_s + 2.0, 2.0, 0.01), limit_s)


def _of_tool(change: ArrivalsChange) -> Fault:
    return Fault(tool=change)


def _of_frames(change: ArrivalsChange) -> Fault:
    return Fault(frames=change)


def _of_ecg(change: ArrivalsChange) -> Fault:
    return Fault(ecg=change)


def _drift_limit_s(rate: float) -> float:
    """6 ms (100 ppm over 60 s) at this rate, and three blocks of 2 s of which the least latency is taken."""
    return 0.006 / abs(rate) + 6.0


_DRIFT = "100 ppm over 60 s are 6 ms; that at the clock's rate, and three blocks of 2 s"


def _clock_rows() -> tuple[Row, ...]:
    back = Hazard.CLOCK_BACKWARDS | Hazard.STALE_TOOL
    skew = (("150 ppm fast", 150e-6), ("150 ppm slow", -150e-6), ("400 ppm fast", 400e-6))
    drifts = tuple(
        Row(
            f"clock drift: {name}",
            Hazard.CLOCK_SKEW,
            _DRIFT,
            _three([_drift(label, faulty, rate) for label, rate in skew]),
        )
        for name, faulty in (("tool", _of_tool), ("ultrasound", _of_frames), ("ECG", _of_ecg))
    )
    ahead = Row(
        "clock ahead: tool",
        Hazard.CLOCK_SKEW,
        "the first pose stamped more than 5 ms after its arrival: one frame, and its arrival",
        _three(
            [
                _tool(f"{1000 * by:g} ms ahead", stamped_back(-by - 0.003), 0.5, FRAME_S + TOOL_ARRIVES_S)
                for by in (0.007, 0.1, 10.0)
            ]
        ),
    )
    returns = (
        Row(
            "clock goes back: tool",
            back,
            "its poses are refused: age beyond 2.5 frames",
            _three([_tool(f"{by:g} s back", stamped_back(by), 0.5, TOO_OLD_S) for by in (0.15, 1.0, 10.0)]),
        ),
        Row(
            "clock goes back: ultrasound",
            Hazard.CLOCK_BACKWARDS,
            "the first frame stamped back: one frame, and its arrival",
            _three(
                [
                    _frames(f"{by:g} s back", stamped_back(by), 0.6, ULTRASOUND_FRAME_S + FRAME_ARRIVES_S)
                    for by in (0.3, 1.0, 10.0)
                ]
            ),
        ),
        Row(
            "clock goes back: ECG",
            Hazard.CLOCK_BACKWARDS,
            "the first packet stamped back: 20 ms, and its arrival",
            _three(
                [_ecg(f"{by:g} s back", stamped_back(by), 0.6, 0.020 + PACKET_S) for by in (0.15, 1.0, 10.0)]
            ),
        ),
    )
    return *drifts, ahead, *returns


def _three(severities: list[Severity]) -> tuple[Severity, Severity, Severity]:
    first, second, third = severities
    return first, second, third


def _tool_rows() -> tuple[Row, ...]:
    lost = Hazard.TOOL_LOST | Hazard.STALE_TOOL
    lengths = (("2 frames", 0.02), ("20 frames", 0.2), ("1.5 s", 1.5))
    return (
        Row(
            "stale tracking",
            Hazard.STALE_TOOL,
            "age beyond the smaller of 2.5 frames, above the usual latency, and 50 ms",
            _three([_tool(f"no pose for {name}", missing, s, TOO_OLD_S) for name, s in lengths]),
        ),
        Row(
            "line of sight lost",
            lost,
            "predicted until 2.5 frames, above the usual latency, after the last pose that was tracked",
            _three([_tool(f"status not OK for {name}", not_tracked, s, TOO_OLD_S) for name, s in lengths]),
        ),
        Row(
            "tool frozen",
            Hazard.TOOL_FROZEN,
            "the fifth pose in a row that is the same: four frames after the last fresh one, and its arrival",
            _three(
                [
                    _tool(f"frozen for {name}", frozen, s, 4 * FRAME_S + TOOL_ARRIVES_S + STEP_S)
                    for name, s in (("5 frames", 0.05), ("20 frames", 0.2), ("1.5 s", 1.5))
                ]
            ),
        ),
        Row(
            "latency jump",
            Hazard.LATENCY_JUMP | Hazard.STALE_TOOL,
            "age 15 ms above its median in 3 of 5 poses, at 30 mm/s: three frames, the jump, the arrival",
            _three(
                [
                    _tool(
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
            _three(
                [
                    _tool(f"{share:.0%} come twice", repeated(share), 2.0, 100 * FRAME_S + TOOL_ARRIVES_S)
                    for share in (0.12, 0.3, 0.5)
                ]
            ),
        ),
        Row(
            "NaN or Inf: tool pose",
            Hazard.NOT_FINITE,
            "the first such pose: one frame, and its arrival",
            _three(
                [
                    _tool(f"NaN in {name}", not_finite, s, FRAME_S + TOOL_ARRIVES_S + STEP_S)
                    for name, s in (("1 pose", 0.01), ("5 poses", 0.05), ("50 poses", 0.5))
                ]
            ),
        ),
        Row(
            "shear or scale: tool pose",
            lost,
            "rejected at 1e-3; as a pose that was not tracked",
            _three(
                [
                    _tool(f"{100 * (by - 1.0):.2g} % of scale", scaled(by), 0.1, TOO_OLD_S)
                    for by in (1.0006, 1.01, 1.2)
                ]
            ),
        ),
        Row(
            "out of volume",
            Hazard.OUT_OF_VOLUME,
            "two frames, the arrival, and 8 ms for 0.24 mm of the tracker's noise at 30 mm/s",
            _three(
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


def _phase_rows() -> tuple[Row, ...]:
    def beats(
        label: str, fault: Fault, seconds: float, limit_s: float, back_s: float = PHASE_BACK_S
    ) -> Severity:
        step_s = STEP_S if limit_s < 1.0 else SLOW_STEP_S
        return Severity(label, SessionFault(fault, seconds, back_s, step_s), limit_s)

    return (
        Row(
            "ECG lead-off",
            Hazard.NO_PHASE,
            "flat, railed or missing for 200 ms, and the packet; hum: no R by 1.35 RR, and the detection",
            (
                beats("flat for 0.3 s", Fault(samples=flat), 0.3, 0.2 + PACKET_S),
                beats("NaN for 1 s", Fault(samples=unplugged), 1.0, 0.2 + PACKET_S),
                beats("hum in place of the ECG for 4 s", Fault(samples=mains_hum), 4.0, LOST_S),
            ),
        ),
        Row(
            "ECG silent",
            Hazard.NO_PHASE,
            "no R by 1.35 RR, and the detection latency",
            _three([_ecg(f"no sample for {s:g} s", missing, s, LOST_S) for s in (1.8, 4.0, 10.0)]),
        ),
        Row(
            "arrhythmia",
            Hazard.NO_PHASE,
            "an early R peak when it is detected; fibrillation within 16 beats",
            (
                beats("one extrasystole", Fault(beats=early_beats(1)), 2.0, DETECTED_S),
                beats("three extrasystoles in a row", Fault(beats=early_beats(3)), 4.0, DETECTED_S),
                beats("fibrillation", Fault(beats=fibrillation), 18.0, 16 * BEAT_S, REGULAR_S),
            ),
        ),
    )


def _pose_rows() -> tuple[Row, ...]:
    confirmed_s = 4 * BEAT_S + DETECTED_S + 0.15
    kinds = (("no frame", missing), ("no image", without_image), ("probe not tracked", not_tracked))
    return (
        Row(
            "not registered",
            Hazard.NO_POSE,
            "from the first state on",
            _three(
                [
                    Severity(
                        f"{name} from the start",
                        SessionFault(Fault(frames=change), 18.0, POSE_BACK_S, from_start=True),
                        WARM_UP_STEP_S,
                    )
                    for name, change in kinds
                ]
            ),
        ),
        Row(
            "pose unconfirmed",
            Hazard.POSE_UNCONFIRMED,
            "three beats after the one that was being compared (below 5 s), and the last one's comparison",
            _three([_frames(f"{name} for 6 s", change, 6.0, confirmed_s) for name, change in kinds]),
        ),
        Row(
            "patient moved",
            Hazard.POSE_CONTRADICTED,
            "three beats after the one in which it happened (docs/theory/trust.md), and the comparison",
            _three(
                [
                    Severity(
                        f"by {by:g} mm",
                        SessionFault(
                            Fault(patient=moved_by(by)), 12.0, POSE_BACK_S, SLOW_STEP_S, by_pose=True
                        ),
                        confirmed_s,
                    )
                    for by in (4.0, 8.0, 15.0)
                ]
            ),
        ),
        Row(
            "registration update jumps",
            Hazard.POSE_CONTRADICTED,
            "in the first state after the registration was taken",
            _three(
                [
                    Severity(
                        f"by {by:g} mm",
                        SessionFault(
                            Fault(registered=registered_off(by)), 4.5, POSE_BACK_S, on_registration=True
                        ),
                        2 * STEP_S,
                    )
                    for by in (3.0, 5.0, 10.0)
                ]
            ),
        ),
        Row(
            "pose follows the patient",
            Hazard.POSE_MOVING,
            "the beat after the one in which it happened, and its comparison; the force follows slowly",
            _three(
                [
                    Severity(
                        f"{by:g} mm within 0.5 s",
                        SessionFault(Fault(patient=moved_by(by)), 3.0, 2.0),
                        2 * BEAT_S + DETECTED_S + 0.15,
                    )
                    for by in (0.5, 1.0, 1.5)
                ]
            ),
        ),
        Row(
            "duplicate or reordered: ultrasound",
            Hazard.REORDERED_STAMPS,
            "more than 10 of the last 100 frames",
            _three(
                [
                    _frames(f"{share:.0%} come twice", repeated(share), 9.0, 100 * ULTRASOUND_FRAME_S + 0.05)
                    for share in (0.12, 0.3, 0.5)
                ]
            ),
        ),
        Row(
            "duplicate or reordered: ECG",
            Hazard.REORDERED_STAMPS,
            "more than 10 of the last 100 packets",
            _three(
                [
                    _ecg(f"{share:.0%} come twice", repeated(share), 3.0, 100 * 0.020 + PACKET_S)
                    for share in (0.12, 0.3, 0.5)
                ]
            ),
        ),
    )


SESSION_ROWS: tuple[Row, ...] = (*_tool_rows(), *_phase_rows(), *_pose_rows(), *_clock_rows())
