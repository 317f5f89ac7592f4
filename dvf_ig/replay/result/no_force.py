"""Why a replay gave no force at all, and how to mend it."""

from enum import Enum

import numpy as np

from dvf_ig.guidance import Status
from dvf_ig.replay.engine import Replay


class NoForce(Enum):
    """Each value is the sentence that a user reads; `{share}` is of the ticks from the first pose on."""

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
        "the tool stayed outside the box of the model in {share:.0%} of the ticks: check that its poses and "
        "tip are in mm, relative to what the probe's are, and of this intervention"
    )
    FAULT = (
        "numbers were not finite in {share:.0%} of the ticks: check poses, tip and model for damaged values"
    )


def no_force_of(replay: Replay) -> str | None:
    """The sentence of the status that most ticks had once there was a pose; None where a tick was valid."""
    status = replay.ticks.status
    if not len(status) or replay.ticks.valid.any():
        return None
    posed = status[status != Status.NO_POSE]
    status = posed if replay.poses and len(posed) else status
    found, count = np.unique(status, return_counts=True)
    most = int(np.argmax(count))
    reason = replay.attempts[-1].reason if replay.attempts else "none, the recording is too short"
    cause = NoForce[Status(int(found[most])).name]
    return cause.value.format(share=count[most] / len(status), reason=reason)
