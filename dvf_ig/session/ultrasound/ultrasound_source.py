"""The ultrasound that has arrived, as work for an executor: registrations, and heart beats to be compared."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dvf_ig.cardiac import RetimeMode, RPeak
from dvf_ig.core import DvfIgError, Fan, Rigid
from dvf_ig.registration import SliceThreads
from dvf_ig.session.calibrations import UltrasoundCalibration
from dvf_ig.session.executor import Executor, Job, answered
from dvf_ig.session.heart import Heart

from .beat_evaluation import ComparedBeat, compare_beat
from .frame_buffer import FrameBuffer
from .frame_registration import RegistrationRecord, RegistrationRequest, register_frames
from .gated_frames import GatedFrames, UltrasoundRecording, gate_recording

_FAILURES = (DvfIgError, np.linalg.LinAlgError)
"""Errors of a registration or a comparison of unfit images."""


class UltrasoundSource(Protocol):
    """The ultrasound that has arrived, as a tracker of the pose asks for it."""

    def register(self, request: RegistrationRequest, known_s: float) -> Job[RegistrationRecord]:
        """Register frames recorded by `known_s`."""
        ...

    def beat(
        self, peaks: tuple[RPeak, ...], known_s: float, pose: Rigid | None, *, in_use: bool
    ) -> Job[ComparedBeat]:
        """The beat that the last R peak ended, compared with a pose unless that is None."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ArrivedUltrasound:
    """An `UltrasoundSource` on the frames that have arrived.

    Attributes:
        seed: of a registration's random choices.
        clock: seconds of computing time, from any origin.
        threads: that beats are evaluated on.
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

    def register(self, request: RegistrationRequest, known_s: float) -> Job[RegistrationRecord]:
        """Gate the frames now, and register them as the executor finds time."""
        recording = self._recording(request.peaks, request.from_s, known_s)
        if recording is None:
            return answered(request.record(None, failure="no ultrasound image has arrived"))
        frames = gate_recording(recording, from_s=request.from_s, until_s=request.until_s)
        if not frames.enough:
            return answered(request.record(frames))
        return self.executor.submit(lambda: self._register(recording, frames, request))

    def beat(
        self, peaks: tuple[RPeak, ...], known_s: float, pose: Rigid | None, *, in_use: bool
    ) -> Job[ComparedBeat]:
        """Prepare the last beat's slices and compare them with a pose, as the executor finds time."""
        recording = self._recording(peaks, peaks[-2].t_s, known_s)
        if recording is None:
            return answered(ComparedBeat(None, None, irregular=False))
        return self.executor.submit(lambda: self._compare(recording, pose, in_use=in_use))

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
                prior=request.prior,
            )
        except _FAILURES as error:
            return request.record(frames, failure=str(error))
        return request.record(frames, result)

    def _compare(self, recording: UltrasoundRecording, pose: Rigid | None, *, in_use: bool) -> ComparedBeat:
        """Black images, for example, are refused: such a beat confirms nothing."""
        try:
            return compare_beat(recording, pose, self.clock, self.threads, in_use=in_use)
        except _FAILURES:
            return ComparedBeat(None, None, irregular=False)

    def _recording(
        self, peaks: tuple[RPeak, ...], from_s: float, known_s: float
    ) -> UltrasoundRecording | None:
        """Frames whose event is later than `from_s`, recorded by `known_s`."""
        part = self.buffer.between(from_s - max(0.0, self.calibrations.lag_s), known_s)
        if part is None:
            return None
        ultrasound, number = part
        return UltrasoundRecording(
            ultrasound, number, self.fan, self.heart, peaks, self.calibrations, self.retiming
        )
