"""Beats that have ended: their frames are gathered, then compared with the pose, then taken or dropped."""

from collections import deque
from dataclasses import dataclass
from math import inf

from dvf_ig.cardiac import RPeak
from dvf_ig.registration import PoseEstimate
from dvf_ig.session.executor import Job
from dvf_ig.session.ultrasound.beat_evaluation import BEAT_COMPUTE_S, ComparedBeat
from dvf_ig.session.ultrasound.ultrasound_source import UltrasoundSource

from .registration_jobs import POLL_S

BEAT_GATHER_S = 0.05
"""Frames of a beat are gathered this long after its R peak was detected, some 0.12 s after its last frame."""
LATEST_BEAT_S = 3.0
"""A beat that is compared this late is dropped: it says too little of the pose by then."""
REMEMBERED_PEAKS = 100
"""R peaks that beats are placed by."""


@dataclass(slots=True)
class _Beat:
    """A beat that has ended; the job is None until its frames are gathered."""

    peaks: tuple[RPeak, ...]
    next_s: float
    tested: PoseEstimate | None = None
    job: Job[ComparedBeat] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FinishedBeat:
    """A beat, and the pose that it was compared with; None where there was none, or the beat was dropped."""

    compared: ComparedBeat
    tested: PoseEstimate | None


class BeatJobs:
    """Beats between their second R peak and the moment their comparison is taken; one after the other."""

    def __init__(self, source: UltrasoundSource) -> None:
        self._source = source
        self._beats: deque[_Beat] = deque()
        self._peaks: deque[RPeak] = deque(maxlen=REMEMBERED_PEAKS)

    @property
    def peaks(self) -> tuple[RPeak, ...]:
        """The last R peaks."""
        return tuple(self._peaks)

    @property
    def next_s(self) -> float:
        """When something is to be done next; infinite where nothing is."""
        return self._beats[0].next_s if self._beats else inf

    def __len__(self) -> int:
        """How many have ended and are not taken yet."""
        return len(self._beats)

    def add_peak(self, peak: RPeak) -> None:
        """An R peak was detected, and a beat ended with it."""
        self._peaks.append(peak)
        if len(self._peaks) > 1:
            self._beats.append(_Beat(tuple(self._peaks), peak.detected_at_s + BEAT_GATHER_S))

    def step(self, now_s: float, tested: PoseEstimate | None, *, in_use: bool) -> FinishedBeat | None:
        """Go on with the oldest beat; what became of it, or None while it is not done.

        Args:
            tested: the pose that a beat whose frames are gathered now is compared with; `in_use`: it gives
                forces, and does not wait to be confirmed.
        """
        beat = self._beats[0]
        if beat.job is None:
            beat.tested = tested
            pose = None if tested is None else tested.matched_pose
            beat.job = self._source.beat(beat.peaks, now_s, pose, in_use=in_use)
            beat.next_s = max(now_s, beat.peaks[-1].detected_at_s + BEAT_COMPUTE_S)
            return None
        if now_s >= beat.peaks[-1].detected_at_s + LATEST_BEAT_S:
            self._beats.popleft()
            return FinishedBeat(ComparedBeat(None, None, irregular=False), None)
        if not beat.job.done():
            beat.next_s = now_s + POLL_S
            return None
        self._beats.popleft()
        return FinishedBeat(beat.job.result(), beat.tested)
