"""Images and the probe's poses that belong to them: both come with stamps of one clock, one after the other.

PLUS sends image and pose of one tracked frame with the same stamp. Where a peer stamps both by themselves,
the pose is interpolated between its neighbours.
"""

from bisect import insort
from collections import deque
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, PoseStream
from dvf_ig.session import Event, TrackedFrame


class LiveEvent(NamedTuple):
    """Event with the arrival of the message that completed it, by this machine's monotonic clock."""

    arrived_s: float
    event: Event


SAME_S = 5e-4
"""Stamps that differ by less are one."""
WAIT_S = 0.3
"""An image whose pose has not come after this long has none."""
MOST_IMAGES, MOST_POSES = 16, 256


class _Pose(NamedTuple):
    t_s: float
    matrix: FloatArray | None


class _Waiting(NamedTuple):
    t_s: float
    image: NDArray[np.uint8] | None
    arrived_s: float


class FramePairing:
    """Puts images and poses together; each stream in its own order."""

    def __init__(self) -> None:
        self._poses: deque[_Pose] = deque(maxlen=MOST_POSES)
        self._images: list[_Waiting] = []
        """In order of their stamps: one that is stamped far ahead keeps no other waiting."""
        self._same_stamps = False
        """Image and pose have come with one stamp: a pose of another is none of the image's."""

    def add_pose(self, t_s: float, matrix: FloatArray | None) -> list[TrackedFrame]:
        """A pose (None: not tracked), and the frames that it completes."""
        self._poses.append(_Pose(t_s, matrix))
        return self._complete()

    def add_image(self, t_s: float, image: NDArray[np.uint8] | None, arrived_s: float) -> list[TrackedFrame]:
        """An image (None: not to be used), and the frames that it completes."""
        if len(self._images) == MOST_IMAGES:
            del self._images[min(range(MOST_IMAGES), key=lambda i: self._images[i].arrived_s)]
        insort(self._images, _Waiting(t_s, image, arrived_s), key=attrgetter("t_s"))
        return self._complete()

    def overdue(self, now_s: float) -> list[TrackedFrame]:
        """Frames whose pose has not come in time; they have none."""
        late = [one for one in self._images if now_s - one.arrived_s > WAIT_S]
        if late:
            self._images = [one for one in self._images if now_s - one.arrived_s <= WAIT_S]
        return [TrackedFrame(one.t_s, one.image, None) for one in late]

    def _complete(self) -> list[TrackedFrame]:
        frames: list[TrackedFrame] = []
        while self._images and self._poses:
            first = self._images[0]
            same = next((p for p in reversed(self._poses) if abs(p.t_s - first.t_s) <= SAME_S), None)
            if same is not None:
                self._same_stamps, matrix = True, same.matrix
            elif self._poses[-1].t_s <= first.t_s:
                return frames
            else:
                matrix = None if self._same_stamps else self._between(first.t_s)
            del self._images[0]
            frames.append(TrackedFrame(first.t_s, first.image, matrix))
        return frames

    def _between(self, t_s: float) -> FloatArray | None:
        after = min((p for p in self._poses if p.t_s > t_s), key=attrgetter("t_s"))
        before = max((p for p in self._poses if p.t_s < t_s), key=attrgetter("t_s"), default=None)
        if before is None or before.matrix is None or after.matrix is None:
            return None
        both = np.stack([before.matrix, after.matrix])
        times = np.array([before.t_s, after.t_s])
        stream = PoseStream(
            "tracker", "probe", times, both[:, :3, :3], both[:, :3, 3], np.ones(2, dtype=bool)
        )
        pose = stream.at(t_s)
        return None if pose is None else pose.matrix
