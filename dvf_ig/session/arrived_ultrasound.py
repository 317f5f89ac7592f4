"""Ultrasound that has arrived: the frames that are still needed, as registrations and compared beats."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.cardiac import RetimeMode, RPeak
from dvf_ig.core import DvfIgError, Fan, InvalidInputError, PoseStream, Rigid, TrackedSequence
from dvf_ig.registration import PoseEstimate, SliceThreads

from .beat_evaluation import ComparedBeat, compare_beat
from .breathing import BreathingTracker
from .clocks import StampOrder
from .events import TrackedFrame
from .gated_frames import GatedFrames, UltrasoundRecording, gate_recording
from .heart import Heart
from .setup import UltrasoundCalibration
from .ultrasound_registration import RegistrationRecord, RegistrationRequest, register_frames
from .work import Executor, Job, answered

KEEP_S = 20.0
"""Frames older than this are forgotten: longer than a registration looks back, and its work is delayed."""
AROUND_S = 0.6
"""Frames this long before the requested ones come with them: their poses are smoothed over neighbours."""
SETTLED_IMAGES = 10
"""Images in a row that fix the images' size: until then one of another size replaces those before, so that a
scanner's first image, which may be anything, decides nothing."""
_FAILURES = (DvfIgError, np.linalg.LinAlgError)
"""Errors of a registration or a comparison of unfit images."""


class FrameBuffer:
    """Takes frames in order of arrival and numbers those that it accepts from 0."""

    def __init__(self) -> None:
        self.order = StampOrder()
        self._frames: deque[TrackedFrame] = deque()
        self._first_number = 0
        self._shape: tuple[int, ...] | None = None
        self._same_size = 0
        """Images in a row of this shape."""

    @property
    def any(self) -> bool:
        """Whether a frame was ever accepted."""
        return self.order.newest_s > float("-inf")

    def push(self, frame: TrackedFrame) -> bool:
        """Add one frame; False if its stamp is not later than all before.

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
            if self._same_size >= SETTLED_IMAGES:
                raise InvalidInputError(
                    f"the frame at {t_s:.3f} s is {shape} pixels, those before {self._shape}; start a new "
                    "session when the scanner's settings change"
                )
            self._frames = deque(replace(frame, image=None) for frame in self._frames)
            self._shape, self._same_size = shape, 0
        self._same_size += 1

    def advance(self, now_s: float) -> None:
        """Forget frames that are not needed from now on; times in order."""
        self.order.advance(now_s)
        while self._frames and self._frames[0].t_s < now_s - KEEP_S:
            self._frames.popleft()
            self._first_number += 1

    def between(self, from_s: float, until_s: float) -> tuple[TrackedSequence, int] | None:
        """Return frames recorded in [from_s, until_s], and those AROUND_S before.

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


@dataclass(frozen=True, slots=True, eq=False)
class ArrivedUltrasound:
    """The frames that have arrived, as jobs (`UltrasoundSource`).

    Attributes:
        seed: of a registration's random choices.
        clock: seconds of computing time, from any origin.
        threads: for evaluating beats.
        breathing: of the patient; None: nothing follows it.
    """

    buffer: FrameBuffer
    heart: Heart
    calibrations: UltrasoundCalibration
    fan: Fan | None
    retiming: RetimeMode
    seed: int
    clock: Callable[[], float]
    threads: SliceThreads
    executor: Executor
    breathing: BreathingTracker | None = None

    def register(self, request: RegistrationRequest, known_s: float) -> Job[RegistrationRecord]:
        """Gate the frames now, and register them when the executor has time."""
        recording = self._recording(request.peaks, request.from_s, known_s, request.start)
        if recording is None:
            return answered(request.record(None, failure="no ultrasound image has arrived"))
        frames = gate_recording(recording, from_s=request.from_s, until_s=request.until_s)
        if not frames.enough:
            return answered(request.record(frames))
        return self.executor.submit(lambda: self._register(recording, frames, request))

    def beat(
        self, peaks: tuple[RPeak, ...], known_s: float, tested: PoseEstimate | None, *, in_use: bool
    ) -> Job[ComparedBeat]:
        """Prepare the last beat's slices and compare them with an estimate when the executor has time."""
        pose = None if tested is None else tested.matched_pose
        recording = self._recording(peaks, peaks[-2].t_s, known_s, pose)
        if recording is None:
            return answered(ComparedBeat(None, None, irregular=False))
        return self.executor.submit(lambda: self._compare(recording, tested, in_use=in_use))

    def _register(
        self, recording: UltrasoundRecording, frames: GatedFrames, request: RegistrationRequest
    ) -> RegistrationRecord:
        try:
            result = register_frames(
                recording,
                frames,
                request.start,
                seed=self.seed,
                clock=self.clock,
                warm=request.warm,
                landmarks=request.prior,
                touched=request.touched,
            )
        except _FAILURES as error:
            return request.record(frames, failure=str(error))
        return request.record(frames, result)

    def _compare(
        self, recording: UltrasoundRecording, tested: PoseEstimate | None, *, in_use: bool
    ) -> ComparedBeat:
        """Compare a beat with an estimate; unfit images, such as black ones, confirm nothing."""
        try:
            return compare_beat(recording, tested, self.clock, self.threads, in_use=in_use)
        except _FAILURES:
            return ComparedBeat(None, None, irregular=False)

    def _recording(
        self, peaks: tuple[RPeak, ...], from_s: float, known_s: float, tested: Rigid | None
    ) -> UltrasoundRecording | None:
        """Return frames whose event is later than `from_s`, recorded by `known_s`; None without any image."""
        part = self.buffer.between(from_s - max(0.0, self.calibrations.lag_s), known_s)
        if part is None:
            return None
        ultrasound, number = part
        return UltrasoundRecording(
            ultrasound,
            number,
            self.fan,
            self.heart,
            peaks,
            self.calibrations,
            self.retiming,
            None
            if self.breathing is None
            else self.breathing.frames(ultrasound.t_s + self.calibrations.lag_s),
            tested,
        )
