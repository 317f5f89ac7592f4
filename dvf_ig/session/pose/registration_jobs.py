"""Registrations that were asked for: their frames are gathered, they are computed, then taken or dropped."""

from dataclasses import dataclass, replace
from math import inf

from dvf_ig.session.executor import Job
from dvf_ig.session.refusal import Refusal, Refused
from dvf_ig.session.ultrasound.frame_registration import RegistrationRecord, RegistrationRequest
from dvf_ig.session.ultrasound.ultrasound_source import UltrasoundSource

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
    job: Job[RegistrationRecord] | None = None
    cancelled: bool = False


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

    def take_answer(self, now_s: float) -> RegistrationRecord | None:
        """Take the answer that is due; None if it is not done yet, and to be asked for again.

        It is refused if the pose in use was suspended after it was asked for.
        """
        asked = self._due(now_s)
        if asked is None or asked.job is None:
            return None
        job = asked.job
        if not job.done() and now_s < asked.asked_s + LATEST_S:
            asked.next_s = now_s + POLL_S
            return None
        self._asked.remove(asked)
        late = asked.request.record(None, failure="not finished in time")
        record = replace(job.result() if job.done() else late, asked_s=asked.asked_s, ready_s=now_s)
        return replace(record, refused=Refused(Refusal.SUSPENDED_MEANWHILE)) if asked.cancelled else record

    def _due(self, now_s: float) -> _Registration | None:
        return next((r for r in self._asked if r.next_s <= now_s and r.job is not None), None)
