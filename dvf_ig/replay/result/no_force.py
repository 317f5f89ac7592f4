"""Reason for which a replay gave no force at all, with advice."""

from collections.abc import Mapping
from enum import Enum

import numpy as np

from dvf_ig.guidance import Status
from dvf_ig.replay.engine import Replay


class NoForce(Enum):
    """Reason for no force; the value is the user's sentence, `{share}` that of ticks since the first pose."""

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


def no_force_of(replay: Replay) -> str | None:
    """Explain no force by the most frequent status since the first pose; None if a tick was valid."""
    codes, count = np.unique(replay.ticks.status, return_counts=True)
    counts = {Status(code): n for code, n in zip(codes.tolist(), count.tolist(), strict=True)}
    reason = replay.attempts[-1].reason if replay.attempts else None
    return no_force(counts, posed=bool(replay.poses), reason=reason)


def no_force(counts: Mapping[Status, int], *, posed: bool, reason: str | None) -> str | None:
    """Explain no force by the number of ticks of each status.

    Args:
        posed: whether a pose was ever in use.
        reason: how the last registration ended; None without one.
    """
    if counts.get(Status.OK, 0) or not sum(counts.values()):
        return None
    frequent: dict[Status, int] = {status: n for status, n in counts.items() if n}
    if posed and set(frequent) != {Status.NO_POSE}:
        frequent.pop(Status.NO_POSE, None)
    most = max(sorted(frequent), key=frequent.__getitem__)
    share = frequent[most] / sum(frequent.values())
    ending = reason or "none, the recording is too short"
    return NoForce[most.name].value.format(share=share, reason=ending)
