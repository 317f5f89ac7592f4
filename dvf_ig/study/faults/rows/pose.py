"""Rows of the table whose faults take the pose: no ultrasound, a patient who moved, stamps in disorder."""

from dvf_ig.guidance import Hazard
from dvf_ig.study.faults.injection.arrivals import missing, not_tracked, repeated, without_image
from dvf_ig.study.faults.injection.fault import Fault
from dvf_ig.study.faults.injection.motion import moved_by, registered_off
from dvf_ig.study.faults.session_trial import WARM_UP_STEP_S, SessionFault

from .delays import BEAT_S, DETECTED_S, PACKET_S, POSE_BACK_S, SLOW_STEP_S, STEP_S, ULTRASOUND_FRAME_S
from .row import Row, Severity
from .severity import ecg_fault, frames_fault, three

_CONFIRMED_S = 4 * BEAT_S + DETECTED_S + 0.15
_KINDS = (("no frame", missing), ("no image", without_image), ("probe not tracked", not_tracked))

POSE_ROWS: tuple[Row, ...] = (
    Row(
        "not registered",
        Hazard.NO_POSE,
        "from the first state on",
        three(
            [
                Severity(
                    f"{name} from the start",
                    SessionFault(Fault(frames=change), 18.0, POSE_BACK_S, from_start=True),
                    WARM_UP_STEP_S,
                )
                for name, change in _KINDS
            ]
        ),
    ),
    Row(
        "pose unconfirmed",
        Hazard.POSE_UNCONFIRMED,
        "three beats after the one that was being compared (below 5 s), and the last one's comparison",
        three([frames_fault(f"{name} for 6 s", change, 6.0, _CONFIRMED_S) for name, change in _KINDS]),
    ),
    Row(
        "patient moved",
        Hazard.POSE_CONTRADICTED,
        "three beats after the one in which it happened (docs/theory/trust.md), and the comparison",
        three(
            [
                Severity(
                    f"by {by:g} mm",
                    SessionFault(Fault(patient=moved_by(by)), 12.0, POSE_BACK_S, SLOW_STEP_S, by_pose=True),
                    _CONFIRMED_S,
                )
                for by in (4.0, 8.0, 15.0)
            ]
        ),
    ),
    Row(
        "registration update jumps",
        Hazard.POSE_CONTRADICTED,
        "in the first state after the registration was taken",
        three(
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
        three(
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
        three(
            [
                frames_fault(f"{share:.0%} come twice", repeated(share), 9.0, 100 * ULTRASOUND_FRAME_S + 0.05)
                for share in (0.12, 0.3, 0.5)
            ]
        ),
    ),
    Row(
        "duplicate or reordered: ECG",
        Hazard.REORDERED_STAMPS,
        "more than 10 of the last 100 packets",
        three(
            [
                ecg_fault(f"{share:.0%} come twice", Fault(ecg=repeated(share)), 3.0, 100 * 0.020 + PACKET_S)
                for share in (0.12, 0.3, 0.5)
            ]
        ),
    ),
)
