"""The ultrasound frames that a session may still need, and parts of them as a tracked sequence."""

from collections import deque
from dataclasses import replace

import numpy as np

from dvf_ig.core import InvalidInputError, PoseStream, TrackedSequence
from dvf_ig.session.events import TrackedFrame
from dvf_ig.session.stamp_order import StampOrder

KEEP_S = 20.0
"""Frames older than this are forgotten: longer than a registration looks back, and its work is delayed."""
AROUND_S = 0.6
"""Frames so long before those that are asked for come with them: their poses are smoothed over neighbours."""
SETTLED_IMAGES = 10
"""The images' size is that of so many in a row: until then one of another size replaces those before, so that
a scanner's first image, which may be anything, decides nothing."""


class FrameBuffer:
    """Takes frames in order of arrival and numbers those that it accepts from 0."""

    def __init__(self) -> None:
        self.order = StampOrder()
        self._frames: deque[TrackedFrame] = deque()
        self._first_number = 0
        self._shape: tuple[int, ...] | None = None
        self._alike = 0
        """Images in a row of this shape."""

    @property
    def any(self) -> bool:
        """Whether a frame was ever accepted."""
        return self.order.newest_s > float("-inf")

    def push(self, frame: TrackedFrame) -> bool:
        """Take one frame; False where its stamp is not later than all before.

        Raises:
            InvalidInputError: its image has another size than SETTLED_IMAGES before.
        """
        if frame.image is not None and frame.t_s > self.order.newest_s:
            self._take_shape(frame.image.shape, frame.t_s)
        if not self.order.accepts(frame.t_s):
            return False
        self._frames.append(frame)
        return True

    def _take_shape(self, shape: tuple[int, ...], t_s: float) -> None:
        if self._shape != shape:
            if self._alike >= SETTLED_IMAGES:
                raise InvalidInputError(
                    f"the frame at {t_s:.3f} s is {shape} pixels, those before {self._shape}; start a new "
                    "session when the scanner's settings change"
                )
            self._frames = deque(replace(frame, image=None) for frame in self._frames)
            self._shape, self._alike = shape, 0
        self._alike += 1

    def advance(self, now_s: float) -> None:
        """Forget what nobody will ask for from now on; times in order."""
        self.order.advance(now_s)
        while self._frames and self._frames[0].t_s < now_s - KEEP_S:
            self._frames.popleft()
            self._first_number += 1

    def between(self, from_s: float, until_s: float) -> tuple[TrackedSequence, int] | None:
        """Frames recorded in [from_s, until_s], and those AROUND_S before.

        Args:
            from_s, until_s: stamps; frames after `until_s` are never looked at.
        Returns:
            the sequence and the running number of its first frame; None without any image.
        """
        numbered = [
            (number, frame)
            for number, frame in enumerate(self._frames, start=self._first_number)
            if from_s - AROUND_S <= frame.t_s <= until_s
        ]
        if not numbered or all(frame.image is None for _, frame in numbered):
            return None
        frames = [frame for _, frame in numbered]
        t_s = np.array([frame.t_s for frame in frames])
        matrices = [frame.tracker_from_probe for frame in frames]
        poses = PoseStream.of_matrices("tracker", "probe", t_s, matrices)
        blank = np.zeros(self._shape or (0, 0), dtype=np.uint8)
        sequence = TrackedSequence(
            t_s=t_s,
            images=np.stack([blank if frame.image is None else frame.image for frame in frames]),
            image_valid=np.array([frame.image is not None for frame in frames]),
            poses={poses.name: poses},
        )
        return sequence, numbered[0][0]
