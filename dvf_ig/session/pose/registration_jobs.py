"""Registrations that were asked for: their frames are gathered, they are computed, then taken or dropped."""

from dataclasses import dataclass
from math import inf

from dvf_ig.session.executor import Job
from dvf_ig.session.ultrasound.ultrasound_source import (
    RegistrationAnswer,
    RegistrationRequest,
    UltrasoundSource,
)

from .history import Attempt

COMPUTE_S = 3.0
"""A registration takes effect this long after its last frame: a fixed allowance for computing it."""
LATEST_S = 12.0
"""A result that comes this late is dropped: the frames it is made of are too old."""
GATHER_S = 0.35
"""Frames are gathered this long after a registration was asked for: the longest gap of poses, and images that
are stamped up to COVERED_LAG_S after what they show; later stamps are waited for besides."""
COVERED_LAG_S = 0.1
"""Stamps so late are covered by GATHER_S."""
POLL_S = 0.01
"""Work that is not done when it is due is asked for again after this."""


@dataclass(slots=True)
class _Registration:
    """A registration that was asked for; the job is None until its frames are gathered."""

    asked_s: float
    request: RegistrationRequest
    next_s: float
    job: Job[RegistrationAnswer] | None = None
    cancelled: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FinishedRegistration:
    """How a registration ended; `cancelled` where the pose in use was suspended after it was asked for."""

    attempt: Attempt
    cancelled: bool


class RegistrationJobs:
    """Registrations between the moment they are asked for and the moment they are taken.

    Args:
        source: the ultrasound that has arrived.
        lag_s: t_tracker(event) = t_video + lag_s.
    """

    def __init__(self, source: UltrasoundSource, lag_s: float) -> None:
        self._source = source
        self._gather_s = GATHER_S + max(0.0, -lag_s - COVERED_LAG_S)
        self._asked: list[_Registration] = []

    @property
    def next_s(self) -> float:
        """When something is to be done next; infinite where nothing is."""
        return min((asked.next_s for asked in self._asked), default=inf)

    def ask(self, request: RegistrationRequest, now_s: float) -> None:
        """Register its frames once all of them have arrived."""
        self._asked.append(_Registration(now_s, request, now_s + self._gather_s))

    def cancel(self) -> None:
        """Those that were asked for so far must not be used."""
        for asked in self._asked:
            asked.cancelled = True

    def gather(self, now_s: float) -> None:
        """Hand the frames of the first registration that is due to the executor."""
        asked = next(r for r in self._asked if r.next_s <= now_s)
        asked.job = self._source.register(asked.request, now_s)
        asked.next_s = max(now_s, asked.asked_s + COMPUTE_S)

    def answer_due(self, now_s: float) -> bool:
        """Whether the answer of one is to be taken."""
        return self._due(now_s) is not None

    def take_answer(self, now_s: float) -> FinishedRegistration | None:
        """What became of the one whose answer is due; None where it is not done yet, and asked for again."""
        asked = self._due(now_s)
        if asked is None or asked.job is None:
            return None
        job = asked.job
        if not job.done() and now_s < asked.asked_s + LATEST_S:
            asked.next_s = now_s + POLL_S
            return None
        self._asked.remove(asked)
        if not job.done():
            attempt = Attempt(asked.asked_s, now_s, None, None, "not finished in time")
        else:
            answer = job.result()
            attempt = Attempt(asked.asked_s, now_s, answer.frames, answer.result, answer.failure)
        return FinishedRegistration(attempt, asked.cancelled)

    def _due(self, now_s: float) -> _Registration | None:
        return next((r for r in self._asked if r.next_s <= now_s and r.job is not None), None)
