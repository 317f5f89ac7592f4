"""Failure of a tracked sensor that keeps moving: lost for good, frozen, or on a restarted clock."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import InvalidInputError, PoseStream

from .occlusion import Intervals


@dataclass(frozen=True, slots=True)
class TrackerFailureSpec:
    """Failure of one sensor.

    Attributes:
        at_share: start of the failure, as a share of the live part.
        lost: no pose is OK from then to the end: the sensor is laid aside, or its cable breaks.
        frozen_s: time for which the last pose is repeated, bit for bit, with status OK.
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
        """Return (start, stop) in which no pose is OK, in a live part of `seconds`."""
        return ((self.at_share * seconds, np.inf),) if self.lost else ()


@dataclass(frozen=True, slots=True)
class ClockRestartSpec:
    """Restart of a tracker's clock.

    Attributes:
        at_share: time of the restart, as a share of the live part.
        back_s: time by which the stamps of all later poses are earlier; 0 is no restart.
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
    """Replace every pose during a failure by the last OK pose before it.

    Without an OK pose before, the stream is returned unchanged.
    """
    start_s = spec.at_share * seconds
    ok_before = np.flatnonzero(stream.valid & (stream.t_s < start_s))
    frozen = (stream.t_s >= start_s) & (stream.t_s < start_s + spec.frozen_s)
    if not len(ok_before) or not frozen.any():
        return stream
    source = np.where(frozen, ok_before[-1], np.arange(len(stream)))
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
    """Split a stream into the poses before the clock's restart and those after, with their new stamps."""
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
