"""A tracked sensor that fails while it goes on moving: lost for good, frozen, or on a restarted clock."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import InvalidInputError, PoseStream

from .occlusion import Intervals


@dataclass(frozen=True, slots=True)
class TrackerFailureSpec:
    """One failure of one sensor.

    Attributes:
        at_share: when it begins, as a share of the live part.
        lost: no pose is OK from then to the end: the sensor is laid aside, or its cable breaks.
        frozen_s: for this long the last pose is reported again and again, bit for bit, with status OK.
    """

    at_share: float = 0.5
    lost: bool = False
    frozen_s: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.at_share <= 1.0 or not 0.0 <= self.frozen_s <= 3600.0:
            raise InvalidInputError(
                f"a sensor fails at {self.at_share:g} of the recording, frozen for {self.frozen_s:g} s; "
                "needed 0 to 1, and 0 to 3600 s"
            )

    def lost_s(self, seconds: float) -> Intervals:
        """(start, stop) in which no pose is OK, in a live part of `seconds`."""
        return ((self.at_share * seconds, np.inf),) if self.lost else ()


@dataclass(frozen=True, slots=True)
class ClockRestartSpec:
    """A tracker's clock that restarts once.

    Attributes:
        at_share: when, as a share of the live part.
        back_s: the stamps of all later poses are this much earlier; 0 is a clock that runs on.
    """

    at_share: float = 0.5
    back_s: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.at_share < 1.0 or not 0.0 <= self.back_s <= 1e6:
            raise InvalidInputError(
                f"a clock restarts at {self.at_share:g} of the recording, {self.back_s:g} s back; "
                "needed between 0 and 1, and 0 to 1 000 000 s"
            )


def with_frozen_poses(stream: PoseStream, spec: TrackerFailureSpec, seconds: float) -> PoseStream:
    """The stream with the last OK pose from before the failure in place of every pose during it.

    Before any OK pose there is nothing to repeat: the stream is returned as it is.
    """
    start_s = spec.at_share * seconds
    held = np.flatnonzero(stream.valid & (stream.t_s < start_s))
    frozen = (stream.t_s >= start_s) & (stream.t_s < start_s + spec.frozen_s)
    if not len(held) or not frozen.any():
        return stream
    source = np.where(frozen, held[-1], np.arange(len(stream)))
    return PoseStream(
        stream.target,
        stream.source,
        stream.t_s,
        stream.rotations[source],
        stream.translations_mm[source],
        stream.valid[source],
    )


def split_at_restart(
    stream: PoseStream, spec: ClockRestartSpec, seconds: float
) -> tuple[PoseStream, PoseStream | None]:
    """What was reported before the clock restarted, and what came after it with the stamps it then got."""
    before = stream.t_s < spec.at_share * seconds
    if spec.back_s == 0 or before.all() or not before.any():
        return stream, None
    first, second = (
        PoseStream(
            stream.target,
            stream.source,
            np.round(stream.t_s[part] - back_s, 6),
            stream.rotations[part],
            stream.translations_mm[part],
            stream.valid[part],
        )
        for part, back_s in ((before, 0.0), (~before, spec.back_s))
    )
    return first, second
