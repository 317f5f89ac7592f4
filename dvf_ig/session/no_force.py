"""Why a session gave no force at all, and what to do."""

from collections.abc import Mapping
from enum import Enum

from dvf_ig.guidance import Status


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
        "the tool stayed outside the box of the model in {share:.0%} of the ticks: check that its poses and "
        "tip are in mm, relative to the same frame as the probe's, and of this intervention"
    )
    FAULT = (
        "numbers were not finite in {share:.0%} of the ticks: check poses, tip and model for damaged values"
    )


def no_force(counts: Mapping[Status, int], *, posed: bool, reason: str | None) -> str | None:
    """The sentence of the status that most ticks had once there was a pose; None if a tick was valid.

    Args:
        counts: how many ticks had each status.
        posed: whether a pose was ever in use.
        reason: how the last registration ended; None without one.
    """
    if counts.get(Status.OK, 0) or not sum(counts.values()):
        return None
    ticks: dict[Status, int] = {status: n for status, n in counts.items() if n}
    if posed and set(ticks) != {Status.NO_POSE}:
        ticks.pop(Status.NO_POSE, None)
    most = max(sorted(ticks), key=ticks.__getitem__)
    share = ticks[most] / sum(ticks.values())
    last = reason or "none, the recording is too short"
    return NoForce[most.name].value.format(share=share, reason=last)
