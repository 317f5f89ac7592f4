"""Reasons for a suspended pose, an unused registration or no force, as the sentences that a user reads."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from dvf_ig.core import Rigid
from dvf_ig.guidance import Status


class DoubtCause(Enum):
    """Each value is the sentence a user reads, with `{since_s}` and `{mm}` filled in."""

    SHIFTED = "heart beats since {since_s:.1f} s fit {mm:.1f} mm from this pose"
    REGISTERED_ELSEWHERE = "a new registration lies {mm:.1f} mm from this pose"
    REFUSED = "two registrations in a row were refused by their own evidence"
    CHANGED = (
        "since {since_s:.1f} s ultrasound matches the model worse than the same views did before: the "
        "heart may be deformed, or something lies before it"
    )
    TIP_ELSEWHERE = (
        "ultrasound shows the tool {mm:.1f} mm from where its tip should be; calibrate the probe and the "
        "tool's tip again"
    )
    BREATHING = "the heart moves with breaths that were not followed before; it is registered again at rest"
    PHASE_OFFSET = "ECG and ultrasound disagree on the phase"


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """One reason to suspend the pose in use.

    Attributes:
        cause: the kind of evidence.
        since_s: begin of the first heart beat that contradicts the pose; 0 if its sentence names none.
        distance_mm: how far the heart seems to have moved, mean over it; 0 if the sentence names none.
        pose: where it seems to lie, mr_from_tracker; None if that is not known.
    """

    cause: DoubtCause
    since_s: float = 0.0
    distance_mm: float = 0.0
    pose: Rigid | None = None

    @property
    def sentence(self) -> str:
        return self.cause.value.format(since_s=self.since_s, mm=self.distance_mm)


class Refusal(Enum):
    """Each value is the sentence a user reads, with the distance `{mm}` filled in."""

    UNCONFIRMED = "waits for heart beats that confirm it"
    LANDMARKS_DISAGREE = (
        "the touched landmarks lie {mm:.1f} mm from where the images put them; check the "
        "probe's calibration, or touch the landmarks again"
    )
    TIP_ELSEWHERE = DoubtCause.TIP_ELSEWHERE.value
    MOVED = "patient or probe moved by {mm:.1f} mm; suspended until heart beats confirm it"
    BEAT_DISAGREES = (
        "ultrasound of a later beat matches best {mm:.1f} mm from this pose; check the probe's "
        "marker and calibration, and that the patient lies still"
    )
    SUSPENDED_MEANWHILE = "a heart beat contradicted the pose in use before this registration was ready"


@dataclass(frozen=True, slots=True)
class Refused:
    """One refusal: its cause, and the distance in mm that its sentence names (0 if it names none)."""

    cause: Refusal
    distance_mm: float = 0.0

    @property
    def sentence(self) -> str:
        return self.cause.value.format(mm=self.distance_mm)


class BreathingReason(Enum):
    """Why a pose is withheld or served at rest alone; each value is the sentence that a user reads."""

    NO_BREATH = "what follows the breath has shown none yet; check its channel or marker if this lasts 20 s"
    LOST = "nothing has come of what follows the breath; check its sender, or the ECG if that does"
    NOT_ORDINARY = "breathing is not ordinary ({what}): the pose waits for ordinary breaths"
    LEARNING = "the motion in breathing is being learnt: force is given at end-expiration alone"
    CHANGED = "breathing has changed for good and is learnt again: force is given at end-expiration alone"
    NOT_LEARNT = "the breath lies outside of what was learnt"
    BY_ECG = (
        "only the ECG follows the breath: force is given at end-expiration alone; record breathing (key "
        "respiration) for force at all times"
    )
    NOT_EXCLUDED = "heart beats are watched for breathing, which nothing follows, before force is given"
    NOT_FOLLOWED = (
        "ultrasound shows the heart moving by {mm:.1f} mm with breaths, some {per_minute:.0f} a minute, that "
        "nothing follows: record them (key respiration), or hold the breath"
    )


class NoForce(Enum):
    """Each value is the sentence that a user reads; `{share}` counts the ticks from the first pose on."""

    STALE_TOOL = (
        "the tool's pose was not known in {share:.0%} of the ticks: check that its recording covers the time "
        "of the ultrasound and the ECG, on the same clock, with poses that are OK and change (dvf-ig inspect)"
    )
    NO_PHASE = (
        "the cardiac phase was not locked in {share:.0%} of the ticks: check the ECG's lead, rate and clock "
        "(dvf-ig gate)"
    )
    NO_POSE = (
        "no registration was in use in {share:.0%} of the ticks: give a better start or a longer sweep, or "
        "check calibrations and clocks; the last registration: {reason}"
    )
    OUT_OF_VOLUME = (
        "the tool stayed outside the box of the model in {share:.0%} of the ticks: check that the MR shows "
        "where it works (dvf-ig view MODEL), and that its poses and tip are in mm, relative to the same "
        "frame as those of the probe, and of this intervention"
    )
    UNSEEN = (
        "the tool was at a part of the heart that no MR slice shows in {share:.0%} of the ticks: check "
        "where slices lie (dvf-ig view MODEL) and work there, or build the model from MR of the whole heart"
    )
    UNSURE_SHAPE = (
        "the heart has changed its shape, and ultrasound has not shown the wall at the tool well enough in "
        "{share:.0%} of the ticks: image that wall too"
    )
    FAULT = (
        "numbers were not finite in {share:.0%} of the ticks: check poses, tip and model for damaged values"
    )


def no_force(counts: Mapping[Status, int], *, posed: bool, reason: str | None, whole: bool) -> str | None:
    """The sentence of the status that most ticks had once there was a pose; None if a tick was valid.

    Args:
        counts: how many ticks had each status.
        posed: whether a pose was ever in use.
        reason: how the last registration ended; None without one.
        whole: the model knows all of the heart, so that a change of shape alone hides a wall.
    """
    if counts.get(Status.OK, 0) or not sum(counts.values()):
        return None
    ticks: dict[Status, int] = {status: n for status, n in counts.items() if n}
    if posed and set(ticks) != {Status.NO_POSE}:
        ticks.pop(Status.NO_POSE, None)
    most = max(sorted(ticks), key=ticks.__getitem__)
    share = ticks[most] / sum(ticks.values())
    last = reason or "none, the recording is too short"
    cause = NoForce.UNSURE_SHAPE if most is Status.UNSEEN and whole else NoForce[most.name]
    return cause.value.format(share=share, reason=last)
