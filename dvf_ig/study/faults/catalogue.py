"""The table of hazards: every row of docs/theory/safety.md, and every member of `Hazard`.

Each row is a fault at three severities, with the time within which it must be detected. The delays that these
limits are made of come first.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dvf_ig.guidance import Hazard
from dvf_ig.registration.unfollowed_breathing import MOST_BEATS
from dvf_ig.study.faults.injection import (
    ArrivalsChange,
    Fault,
    alternating,
    breathing_by,
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
from dvf_ig.study.faults.servo_trial import (
    ServoFault,
    device_silent,
    jumps,
    late_ticks,
    place_not_finite,
    session_silent,
    trembling,
)
from dvf_ig.study.faults.session_trial import WARM_UP_STEP_S, SessionFault
from dvf_ig.study.faults.start_trial import (
    PATIENT,
    RAS,
    Start,
    StartFault,
    calibrated_off,
    marked_in,
    of_patient,
    pose_file_scaled,
    posed_in,
    with_bytes_changed,
)

STEP_S, SLOW_STEP_S = 0.001, 0.004
"""States are a millisecond apart, which each limit includes; where it is a second or more, four."""
FRAME_S, TOOL_ARRIVES_S, FRAME_ARRIVES_S = 0.010, 0.007, 0.035
"""The tool's frame; a pose or an ultrasound frame has arrived so long after its stamp, jitter included."""
ULTRASOUND_FRAME_S = 1.0 / 12.0
PACKET_S = 0.028
"""A packet of the ECG has arrived so long after its first sample."""
LATE_FOR_S = 0.15
"""Duration of a jump: after half of the last 32 poses it is the usual latency, over which the tip
is predicted."""
USUAL_LATE_S = 0.0045
"""Median latency of the tool's poses, and the jitter of their stamps."""
TOO_OLD_S = 2.5 * FRAME_S + USUAL_LATE_S + STEP_S
BEAT_S = 0.90
"""Longest interval at 72 beats/min with the study's variability."""
DETECTED_S = 0.25
"""An R peak is known so long after it: 0.139 s in 95 % (docs/theory/cardiac.md), and the packet's arrival."""
LOST_S = 1.35 * BEAT_S + DETECTED_S
PHASE_BACK_S, POSE_BACK_S, REGULAR_S, BREATH_GONE_S = 12.0, 16.0, 45.0, 40.0
"""The operator waits so long for the phase, for a registration that beats confirm, and for the phase after
fibrillation: forecasts that failed are forgotten by 5 % a beat; and until breaths have left all beats that
are remembered."""


@dataclass(frozen=True, slots=True)
class Severity:
    """One severity of a fault.

    Attributes:
        label: what is done, as a reader sees it.
        fault: the same for the trial.
        limit_s: within which it must be detected, from its begin.
    """

    label: str
    fault: SessionFault | ServoFault | StartFault
    limit_s: float


@dataclass(frozen=True, slots=True)
class Row:
    """One row.

    Attributes:
        name: of the hazard, as docs/theory/safety.md has it, and what is disturbed.
        hazards: any of which detects the fault; NONE where a start is to be refused.
        limit: how the time limit follows from docs/theory/safety.md.
        severities: SEVERITIES, the least first, which lies just above what must be detected.
    """

    name: str
    hazards: Hazard
    limit: str
    severities: tuple[Severity, ...]


def tool_fault(label: str, change: ArrivalsChange, seconds: float, limit_s: float) -> Severity:
    """Fault of the tool's poses that lasts `seconds`."""
    return Severity(label, SessionFault(Fault(tool=change), seconds), limit_s)


def frames_fault(label: str, change: ArrivalsChange, seconds: float, limit_s: float) -> Severity:
    """Fault of ultrasound frames; the pose is back only after another registration."""
    fault = SessionFault(Fault(frames=change), seconds, POSE_BACK_S, state_step_s(limit_s))
    return Severity(label, fault, limit_s)


def ecg_fault(
    label: str, fault: Fault, seconds: float, limit_s: float, back_s: float = PHASE_BACK_S
) -> Severity:
    """Fault of the ECG or the heart's rhythm; `back_s` passes until the phase is known again."""
    return Severity(label, SessionFault(fault, seconds, back_s, state_step_s(limit_s)), limit_s)


def state_step_s(limit_s: float) -> float:
    """Time between two states of a trial: fine enough for the limit."""
    return STEP_S if limit_s < 1.0 else SLOW_STEP_S


_LOST = Hazard.TOOL_LOST | Hazard.STALE_TOOL
_GAPS = (("2 frames", 0.02), ("20 frames", 0.2), ("1.5 s", 1.5))

TOOL_ROWS: tuple[Row, ...] = (
    Row(
        "stale tracking",
        Hazard.STALE_TOOL,
        "age beyond the smaller of 2.5 frames, above the usual latency, and 50 ms",
        tuple(tool_fault(f"no pose for {name}", missing, s, TOO_OLD_S) for name, s in _GAPS),
    ),
    Row(
        "line of sight lost",
        _LOST,
        "predicted until 2.5 frames, above the usual latency, after the last pose that was tracked",
        tuple(tool_fault(f"status not OK for {name}", not_tracked, s, TOO_OLD_S) for name, s in _GAPS),
    ),
    Row(
        "tool frozen",
        Hazard.TOOL_FROZEN,
        "the fifth pose in a row that is the same: four frames after the last fresh one, and its arrival",
        tuple(
            tool_fault(f"frozen for {name}", frozen, s, 4 * FRAME_S + TOOL_ARRIVES_S + STEP_S)
            for name, s in (("5 frames", 0.05), ("20 frames", 0.2), ("1.5 s", 1.5))
        ),
    ),
    Row(
        "latency jump",
        Hazard.LATENCY_JUMP | Hazard.STALE_TOOL,
        "age 15 ms above its median in 3 of 5 poses, at 30 mm/s: three frames, the jump, the arrival",
        tuple(
            tool_fault(
                f"{1000 * by:g} ms later", late(by), LATE_FOR_S, 3 * FRAME_S + by + TOOL_ARRIVES_S + STEP_S
            )
            for by in (0.018, 0.040, 0.100)
        ),
    ),
    Row(
        "duplicate or reordered: tool",
        Hazard.REORDERED_STAMPS,
        "more than 10 of the last 100 poses",
        tuple(
            tool_fault(f"{share:.0%} come twice", repeated(share), 2.0, 100 * FRAME_S + TOOL_ARRIVES_S)
            for share in (0.12, 0.3, 0.5)
        ),
    ),
    Row(
        "two programs send the tool",
        Hazard.TOOL_CONTRADICTED,
        "four steps back: five poses, and their arrival",
        tuple(
            tool_fault(f"{by:g} mm apart", alternating(by), 0.5, 5 * FRAME_S + TOOL_ARRIVES_S + STEP_S)
            for by in (4.0, 15.0, 60.0)
        ),
    ),
    Row(
        "NaN or Inf: tool pose",
        Hazard.NOT_FINITE,
        "the first such pose: one frame, and its arrival",
        tuple(
            tool_fault(f"NaN in {name}", not_finite, s, FRAME_S + TOOL_ARRIVES_S + STEP_S)
            for name, s in (("1 pose", 0.01), ("5 poses", 0.05), ("50 poses", 0.5))
        ),
    ),
    Row(
        "shear or scale: tool pose",
        _LOST,
        "rejected at 1e-3; as a pose that was not tracked",
        tuple(
            tool_fault(f"{100 * (by - 1.0):.2g} % of scale", scaled(by), 0.1, TOO_OLD_S)
            for by in (1.0006, 1.01, 1.2)
        ),
    ),
    Row(
        "out of volume",
        Hazard.OUT_OF_VOLUME,
        "two frames, the arrival, and 8 ms for 0.24 mm of the tracker's noise at 30 mm/s",
        tuple(
            Severity(
                f"{by:g} mm beyond the box",
                SessionFault(Fault(tip=leaving(by)), 0.6),
                2 * FRAME_S + TOOL_ARRIVES_S + 0.008,
            )
            for by in (0.5, 2.0, 8.0)
        ),
    ),
)


PHASE_ROWS: tuple[Row, ...] = (
    Row(
        "ECG lead-off",
        Hazard.NO_PHASE,
        "flat, railed or missing for 200 ms, and the packet; hum: no R by 1.35 RR, and the detection",
        (
            ecg_fault("flat for 0.3 s", Fault(samples=flat), 0.3, 0.2 + PACKET_S),
            ecg_fault("NaN for 1 s", Fault(samples=unplugged), 1.0, 0.2 + PACKET_S),
            ecg_fault("hum in place of the ECG for 4 s", Fault(samples=mains_hum), 4.0, LOST_S),
        ),
    ),
    Row(
        "ECG silent",
        Hazard.NO_PHASE,
        "no R by 1.35 RR, and the detection latency",
        tuple(ecg_fault(f"no sample for {s:g} s", Fault(ecg=missing), s, LOST_S) for s in (1.8, 4.0, 10.0)),
    ),
    Row(
        "arrhythmia",
        Hazard.NO_PHASE,
        "an early R peak when it is detected; fibrillation within 16 beats",
        (
            ecg_fault("one extrasystole", Fault(beats=early_beats(1)), 2.0, DETECTED_S),
            ecg_fault("three extrasystoles in a row", Fault(beats=early_beats(3)), 4.0, DETECTED_S),
            ecg_fault("fibrillation", Fault(beats=fibrillation), 18.0, 16 * BEAT_S, REGULAR_S),
        ),
    ),
)


_CONFIRMED_S = 4 * BEAT_S + DETECTED_S + 0.15
_KINDS = (("no frame", missing), ("no image", without_image), ("probe not tracked", not_tracked))

POSE_ROWS: tuple[Row, ...] = (
    Row(
        "not registered",
        Hazard.NO_POSE,
        "from the first state on",
        tuple(
            Severity(
                f"{name} from the start",
                SessionFault(Fault(frames=change), 18.0, POSE_BACK_S, from_start=True),
                WARM_UP_STEP_S,
            )
            for name, change in _KINDS
        ),
    ),
    Row(
        "pose unconfirmed",
        Hazard.POSE_UNCONFIRMED,
        "three beats after the one that was being compared (below 5 s), and the last one's comparison",
        tuple(frames_fault(f"{name} for 6 s", change, 6.0, _CONFIRMED_S) for name, change in _KINDS),
    ),
    Row(
        "patient moved",
        Hazard.POSE_CONTRADICTED,
        "three beats after the one in which it happened (docs/theory/trust.md), and the comparison",
        tuple(
            Severity(
                f"by {by:g} mm",
                SessionFault(Fault(patient=moved_by(by)), 12.0, POSE_BACK_S, SLOW_STEP_S, by_pose=True),
                _CONFIRMED_S,
            )
            for by in (4.0, 8.0, 15.0)
        ),
    ),
    Row(
        "registration update jumps",
        Hazard.POSE_CONTRADICTED,
        "in the first state after the registration was taken",
        tuple(
            Severity(
                f"by {by:g} mm",
                SessionFault(Fault(registered=registered_off(by)), 4.5, POSE_BACK_S, on_registration=True),
                2 * STEP_S,
            )
            for by in (3.0, 5.0, 10.0)
        ),
    ),
    Row(
        "pose follows the patient",
        Hazard.POSE_MOVING,
        "the beat after the one in which it happened, and its comparison; the force follows slowly",
        tuple(
            Severity(
                f"{by:g} mm within 0.5 s",
                SessionFault(Fault(patient=moved_by(by)), 3.0, 2.0),
                2 * BEAT_S + DETECTED_S + 0.15,
            )
            for by in (0.5, 1.0, 1.5)
        ),
    ),
    Row(
        "breathing that nothing follows",
        Hazard.BREATHING | Hazard.POSE_CONTRADICTED,
        "the beats that are remembered (docs/theory/respiration.md), and the last one's comparison",
        tuple(
            Severity(
                f"{by:g} mm from end to end",
                SessionFault(Fault(patient=breathing_by(by)), 36.0, BREATH_GONE_S, SLOW_STEP_S),
                MOST_BEATS * BEAT_S + DETECTED_S + 0.15,
            )
            for by in (4.5, 6.0, 10.0)
        ),
    ),
    Row(
        "duplicate or reordered: ultrasound",
        Hazard.REORDERED_STAMPS,
        "more than 10 of the last 100 frames",
        tuple(
            frames_fault(f"{share:.0%} come twice", repeated(share), 9.0, 100 * ULTRASOUND_FRAME_S + 0.05)
            for share in (0.12, 0.3, 0.5)
        ),
    ),
    Row(
        "duplicate or reordered: ECG",
        Hazard.REORDERED_STAMPS,
        "more than 10 of the last 100 packets",
        tuple(
            ecg_fault(f"{share:.0%} come twice", Fault(ecg=repeated(share)), 3.0, 100 * 0.020 + PACKET_S)
            for share in (0.12, 0.3, 0.5)
        ),
    ),
)


def _drift_row(stream: str, faulty: Callable[[ArrivalsChange], Fault]) -> Row:
    """A clock that gains time."""
    skew = (("150 ppm fast", 150e-6), ("150 ppm slow", -150e-6), ("400 ppm fast", 400e-6))
    return Row(
        f"clock drift: {stream}",
        Hazard.CLOCK_SKEW,
        "100 ppm over 60 s are 6 ms; that at the clock's rate, and three blocks of 2 s",
        tuple(_drift(label, faulty(drifting(rate)), rate) for label, rate in skew),
    )


def _drift(label: str, fault: Fault, rate: float) -> Severity:
    """The fault lasts until it must have been found, and a little longer."""
    # 6 ms (100 ppm over 60 s) at this rate, and three blocks of 2 s of which the least latency is taken
    limit_s = 0.006 / abs(rate) + 6.0
    return Severity(label, SessionFault(fault, limit_s + 2.0, 2.0, 0.01), limit_s)


CLOCK_ROWS: tuple[Row, ...] = (
    _drift_row("tool", lambda change: Fault(tool=change)),
    _drift_row("ultrasound", lambda change: Fault(frames=change)),
    _drift_row("ECG", lambda change: Fault(ecg=change)),
    Row(
        "clock ahead: tool",
        Hazard.CLOCK_SKEW,
        "the first pose stamped more than 5 ms after its arrival: one frame, and its arrival",
        tuple(
            tool_fault(f"{1000 * by:g} ms ahead", stamped_back(-by - 0.003), 0.5, FRAME_S + TOOL_ARRIVES_S)
            for by in (0.007, 0.1, 10.0)
        ),
    ),
    Row(
        "clock goes back: tool",
        Hazard.CLOCK_BACKWARDS | Hazard.STALE_TOOL,
        "its poses are refused: age beyond 2.5 frames",
        tuple(tool_fault(f"{by:g} s back", stamped_back(by), 0.5, TOO_OLD_S) for by in (0.15, 1.0, 10.0)),
    ),
    Row(
        "clock goes back: ultrasound",
        Hazard.CLOCK_BACKWARDS,
        "the first frame stamped back: one frame, and its arrival",
        tuple(
            frames_fault(f"{by:g} s back", stamped_back(by), 0.6, ULTRASOUND_FRAME_S + FRAME_ARRIVES_S)
            for by in (0.3, 1.0, 10.0)
        ),
    ),
    Row(
        "clock goes back: ECG",
        Hazard.CLOCK_BACKWARDS,
        "the first packet stamped back: 20 ms, and its arrival",
        tuple(
            ecg_fault(f"{by:g} s back", Fault(ecg=stamped_back(by)), 0.6, 0.020 + PACKET_S)
            for by in (0.15, 1.0, 10.0)
        ),
    ),
)


TICK_S = 0.001

SERVO_ROWS: tuple[Row, ...] = (
    Row(
        "NaN or Inf: device",
        Hazard.NOT_FINITE,
        "the first such tick",
        (
            Severity("NaN in 1 tick", ServoFault(place_not_finite, 0.001), TICK_S),
            Severity("NaN in 10 ticks", ServoFault(place_not_finite, 0.01), TICK_S),
            Severity("NaN in 100 ticks", ServoFault(place_not_finite, 0.1), TICK_S),
        ),
    ),
    Row(
        "device lost",
        Hazard.DEVICE_LOST,
        "the first tick without an answer",
        (
            Severity("no answer in 1 tick", ServoFault(device_silent, 0.001), TICK_S),
            Severity("no answer in 20 ticks", ServoFault(device_silent, 0.02), TICK_S),
            Severity("no answer for 0.5 s", ServoFault(device_silent, 0.5), TICK_S),
        ),
    ),
    Row(
        "session silent",
        Hazard.SESSION_SILENT,
        "0.1 s after the last word, and a tick",
        (
            Severity("three words missing", ServoFault(session_silent, 0.1), 0.1 + 2 * TICK_S),
            Severity("silent for 0.5 s", ServoFault(session_silent, 0.5), 0.1 + 2 * TICK_S),
            Severity("silent for 2 s", ServoFault(session_silent, 2.0), 0.1 + 2 * TICK_S),
        ),
    ),
    Row(
        "force jump",
        Hazard.FORCE_CLAMPED,
        "the tenth jump within 1 s, each by more than 0.1 N in a tick: 0.4 s at 25 jumps a second",
        (
            Severity("jumps of 0.12 N", ServoFault(jumps(0.8, 0.04), 1.0), 0.4 + 2 * TICK_S),
            Severity("jumps of 0.3 N", ServoFault(jumps(2.2, 0.04), 1.0), 0.4 + 2 * TICK_S),
            Severity("jumps of 0.55 N", ServoFault(jumps(6.4, 0.04), 1.0), 0.4 + 2 * TICK_S),
        ),
    ),
    Row(
        "missed deadlines",
        Hazard.MISSED_DEADLINES,
        "when the third late tick within 100 wakes",
        (
            Severity("3 of 100 late by 2.1 ms", ServoFault(late_ticks(0.0021, 3, 48), 0.2), 0.0021 + TICK_S),
            Severity("3 of 40 late by 2.5 ms", ServoFault(late_ticks(0.0025, 3, 18), 0.2), 0.0025 + TICK_S),
            Severity("3 of 10 late by 2.9 ms", ServoFault(late_ticks(0.0029, 3, 4), 0.2), 0.0029 + TICK_S),
        ),
    ),
    Row(
        "watchdog",
        Hazard.MISSED_DEADLINES,
        "10 ms after the last tick, and the watchdog's period of 1 ms",
        (
            Severity("no tick for 11.5 ms", ServoFault(late_ticks(0.0105, 1, 1), 0.2, restarts=True), 0.011),
            Severity("no tick for 30 ms", ServoFault(late_ticks(0.030, 1, 1), 0.2, restarts=True), 0.011),
            Severity("no tick for 0.3 s", ServoFault(late_ticks(0.3, 1, 1), 0.5, restarts=True), 0.011),
        ),
    ),
    Row(
        "energy",
        Hazard.ENERGY,
        "the tick in which the energy made passes 5 mJ, summed from places and forces",
        (
            Severity(
                "hand trembles by 1.5 mm", ServoFault(trembling(1.5, 20.0), 6.0, by_energy=True), TICK_S
            ),
            Severity(
                "hand trembles by 2.5 mm", ServoFault(trembling(2.5, 20.0), 4.0, by_energy=True), TICK_S
            ),
            Severity("hand trembles by 4 mm", ServoFault(trembling(4.0, 20.0), 4.0, by_energy=True), TICK_S),
        ),
    ),
)


AT_START = "before the first force"
SAME = np.ones(3)


def _refused(label: str, start: Start, clean: Start) -> Severity:
    return Severity(label, StartFault(start, clean), 0.0)


START_ROWS: tuple[Row, ...] = (
    Row(
        "LPS/RAS",
        Hazard.NONE,
        AT_START,
        (
            _refused(
                "marked landmarks in RAS, heart on the axis of the flip",
                marked_in(RAS, on_axis=True),
                marked_in(SAME, on_axis=True),
            ),
            _refused("marked landmarks in RAS", marked_in(RAS), marked_in(SAME)),
            _refused("start pose in RAS", posed_in(RAS), posed_in(SAME)),
        ),
    ),
    Row(
        "probe calibration",
        Hazard.NONE,
        AT_START,
        (
            _refused("known points 1.3 mm off", calibrated_off(1.3), calibrated_off(0.0)),
            _refused("known points 3 mm off", calibrated_off(3.0), calibrated_off(0.0)),
            _refused("known points 8 mm off", calibrated_off(8.0), calibrated_off(0.0)),
        ),
    ),
    Row(
        "shear or scale: start pose",
        Hazard.NONE,
        AT_START,
        (
            _refused("0.06 % of scale", pose_file_scaled(1.0006), pose_file_scaled(1.0)),
            _refused("1 % of scale", pose_file_scaled(1.01), pose_file_scaled(1.0)),
            _refused("mirrored", pose_file_scaled(-1.0), pose_file_scaled(1.0)),
        ),
    ),
    Row(
        "model of another patient",
        Hazard.NONE,
        AT_START,
        (
            _refused("a name with another capital", of_patient(PATIENT.upper()), of_patient(PATIENT)),
            _refused("one bit of the file changed", with_bytes_changed(1), with_bytes_changed(0)),
            _refused("100 bits of the file changed", with_bytes_changed(100), with_bytes_changed(0)),
        ),
    ),
)


ROWS: tuple[Row, ...] = (*TOOL_ROWS, *PHASE_ROWS, *POSE_ROWS, *CLOCK_ROWS, *SERVO_ROWS, *START_ROWS)
SEVERITIES = 3
