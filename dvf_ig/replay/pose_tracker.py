"""Where the heart is from moment to moment: registrations on a timetable, and every beat in between.

    first     a registration from the start pose, retried until one is explained by the beats that follow
    guiding   each beat is watched and tracked (`registration.track`); a registration now and then besides
    in doubt  no force; a registration from frames after the disturbance, and the beats that confirm it

Everything happens in time order. A registration's answer is in force COMPUTE_S after it was asked for; beats
that end meanwhile are asked about the pose in use, and about its answer once that is there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from dvf_ig.cardiac import RPeak
from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration import PoseEstimate, RegistrationResult

from .beat_evaluation import Beat
from .gated_frames import Sight
from .registration_monitor import Trust

FIRST_ATTEMPT_S = 8.0
RETRY_S = 4.0
REFRESH_S = 12.0
RECOVER_S = 3.0
"""After doubt, a registration is asked for when frames of this long after the disturbance are at hand."""
MEMORY_S = 12.0
"""How far back a registration looks: one refresh, so that a patient who moved is seen unmixed by the next."""
COMPUTE_S = 3.0
"""A registration is in force this long after its last frame: a fixed allowance for computing it."""
REMEMBERED_BEATS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """One registration: when it was asked for, from when it could be used, what it saw and what it gave.

    `result` is None where too few frames passed the gate. `refusal` says why an attempt does not guide though
    its own evidence would let it: too few frames, see `trust`, or beats that it does not explain.
    """

    asked_s: float
    ready_s: float
    sight: Sight
    result: RegistrationResult | None
    refusal: str = ""

    @property
    def usable(self) -> bool:
        return self.result is not None and self.result.stop.usable and not self.refusal


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """What was known of the heart's place, in time order.

    Attributes:
        attempts, beats: what was asked of the ultrasound.
        updates: (from when, the pose to guide by); None where it was put in doubt.
    """

    attempts: tuple[Attempt, ...]
    beats: tuple[Beat, ...]
    updates: tuple[tuple[float, Rigid | None], ...]


class Asked(Protocol):
    """The slices of one beat, see `watch.BeatSlices`."""

    @property
    def begin_s(self) -> float: ...

    @property
    def end_s(self) -> float: ...

    def asked(self, pose: Rigid, center_mm: FloatArray, guided: bool) -> Beat | None: ...


@dataclass(frozen=True, slots=True)
class Eyes:
    """What can be asked of the ultrasound.

    Attributes:
        register: (from_s, until_s, start, warm) to what was seen, the result, and why there is none.
        beat: number of the R peak that ended it to its slices; None where they cannot be compared.
    """

    register: Callable[[float, float, Rigid, bool], tuple[Sight, RegistrationResult | None, str]]
    beat: Callable[[int], Asked | None]


def follow(
    eyes: Eyes,
    peaks: Sequence[RPeak],
    trust: Trust,
    start: Rigid,
    *,
    begin_s: float,
    end_s: float,
    decide_s: float,
    tell: Callable[[float], None],
) -> Course:
    """Follow the heart from the first ultrasound frame to the end of the recording.

    Args:
        peaks: R peaks in time order.
        start: coarse pose that the first registrations begin at.
        begin_s: event time of the first frame; end_s: last tick.
        decide_s: what a beat tells is in force so long after its R peak was detected.
    """
    follower = _Follower(eyes, peaks, trust, start, begin_s, end_s)
    for last in range(1, len(peaks)):
        now_s = peaks[last].detected_at_s + decide_s
        if now_s > end_s:
            break
        follower.register_until(now_s)
        follower.see_beat(last, now_s)
        tell(min(1.0, max(0.0, (now_s - begin_s) / (end_s - begin_s))))
    follower.register_until(end_s)
    return Course(tuple(follower.attempts), tuple(follower.beats), tuple(follower.updates))


class _Follower:
    """The state that moves through the recording; see the module docstring."""

    def __init__(
        self,
        eyes: Eyes,
        peaks: Sequence[RPeak],
        trust: Trust,
        start: Rigid,
        begin_s: float,
        end_s: float,
    ) -> None:
        self._eyes, self._peaks, self._trust, self._start = eyes, peaks, trust, start
        self._clean_s, self._end_s = begin_s, end_s
        self._ask_s, self._ready_s = begin_s + FIRST_ATTEMPT_S, np.inf
        self._recent: list[Asked] = []
        self._would_have: Rigid | None = None
        self._tried = -1
        self.attempts: list[Attempt] = []
        self.beats: list[Beat] = []
        self.updates: list[tuple[float, Rigid | None]] = []

    def register_until(self, now_s: float) -> None:
        """Registrations that are to be asked for, or whose answers come into force, by now."""
        while min(self._ask_s, self._ready_s) <= now_s:
            if self._ready_s <= self._ask_s:
                self._answer(self._ready_s)
            else:
                self._ask(self._ask_s)

    def see_beat(self, last: int, now_s: float) -> None:
        slices = self._eyes.beat(last)
        if slices is None:
            return
        self._recent = [*self._recent[1 - REMEMBERED_BEATS :], slices]
        self._try(slices, now_s)

    def _ask(self, now_s: float) -> None:
        self._ask_s = np.inf
        if now_s + COMPUTE_S >= self._end_s:
            return
        start, warm = self._start_from()
        since_s = max(self._clean_s, now_s - MEMORY_S)
        sight, result, refusal = self._eyes.register(since_s, now_s, start, warm)
        self.attempts.append(Attempt(now_s, now_s + COMPUTE_S, sight, result, refusal))
        self._ready_s = now_s + COMPUTE_S

    def _start_from(self) -> tuple[Rigid, bool]:
        """Where a registration begins, and whether that is trusted.

        Right after doubt it is where the last beat would have the pose; once such a start has failed,
        displaced copies of the last pose are tried besides.
        """
        on_trial = self._trust.on_trial
        if on_trial is None:
            return self._start, False
        if self._trust.guiding:
            return on_trial.pose, True
        if self._would_have is not None:
            start, self._would_have = self._would_have, None
            return start, True
        return on_trial.pose, False

    def _answer(self, now_s: float) -> None:
        self._ready_s, attempt = np.inf, self.attempts[-1]
        self._ask_s = attempt.asked_s + RETRY_S
        if attempt.result is None or not attempt.result.stop.usable:
            return
        result, sight = attempt.result, attempt.sight
        middle_s = float(sight.event_s[sight.used].mean())
        beats = sum(middle_s < p.t_s < now_s for p in self._peaks)
        found = PoseEstimate.from_registration(result.target_from_source, result.covariance, result.center_mm)
        before = self._trust
        self._trust, refusal = before.registered(found, beats)
        self._refused(-1, refusal)
        self._note(before, now_s)
        if self._trust.candidate is found:
            self._tried = len(self.attempts) - 1
            self._ask_s = now_s + REFRESH_S
            for slices in [s for s in self._recent if s.begin_s >= attempt.asked_s]:
                if self._trust.guiding or self._trust.candidate is found:
                    self._try(slices, now_s)
        elif self._trust.guiding:
            self._ask_s = attempt.asked_s + self._refresh_s(attempt.asked_s)

    def _try(self, slices: Asked, now_s: float) -> None:
        """Ask a beat about the pose on trial."""
        before = self._trust
        on_trial = before.on_trial
        if on_trial is None:
            return
        beat = slices.asked(on_trial.pose, before.center_mm, before.guiding is not None)
        if beat is None:
            return
        self.beats.append(beat)
        self._trust = before.saw(beat.look)
        self._note(before, now_s)
        if before.guiding and not self._trust.guiding:
            self._disturbed(slices.end_s, beat.look.best, now_s)
        elif before.candidate is None and self._would_have is not None:
            self._would_have = beat.look.best
        elif before.candidate and self._trust.guiding:
            self._refused(self._tried, "")
            asked_s = self.attempts[self._tried].asked_s
            self._ask_s = max(now_s, asked_s + self._refresh_s(asked_s))
        elif before.candidate and self._trust.candidate is None:
            self._ask_s = max(now_s, self.attempts[self._tried].asked_s + RETRY_S)
            self._refused(
                self._tried,
                f"a later heart beat would have the pose {beat.look.moved_mm:.1f} mm away; check the probe's "
                "marker and calibration, and that the patient lies still",
            )

    def _disturbed(self, end_s: float, would_have: Rigid, now_s: float) -> None:
        """Start anew from frames after the beat that put the pose in doubt."""
        if np.isfinite(self._ready_s):
            self._refused(len(self.attempts) - 1, "a heart beat put the pose in doubt before it was ready")
        self._clean_s, self._would_have = end_s, would_have
        self._ask_s, self._ready_s = max(now_s, end_s + RECOVER_S), np.inf

    def _refused(self, attempt: int, refusal: str) -> None:
        self.attempts[attempt] = replace(self.attempts[attempt], refusal=refusal)

    def _refresh_s(self, asked_s: float) -> float:
        """A registration from little is repeated when there is twice as much."""
        return min(REFRESH_S, max(RETRY_S, asked_s - max(self._clean_s, asked_s - MEMORY_S)))

    def _note(self, before: Trust, now_s: float) -> None:
        was, guiding = before.guiding, self._trust.guiding
        if guiding is not was:
            self.updates.append((now_s, guiding.pose if guiding else None))
