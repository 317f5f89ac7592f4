"""Sentences of a live session: what it does as that changes, and what cannot be used, counted by kind."""

import re
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from dvf_ig.guidance import RearmAnswer, SupervisorState
from dvf_ig.session import GuidanceState

MOST_KINDS = 100
REARM = "press r and Enter in the terminal of dvf-ig serve to re-arm"
LASTS_S = 0.3
"""Time after which a new state is reported; a latch is at once."""
LOOK_EVERY_S = 0.1
_NUMBERS = re.compile(r"\d[\d.,e+-]*")


@dataclass(slots=True)
class Narrator:
    """Reports peers, state and registrations of a session when they change; called several times a second.

    Attributes:
        say: called with a sentence.
    """

    say: Callable[[str], None]
    _peers: tuple[str, ...] = ()
    _begin_s: float | None = None
    _phrase: str = ""
    _pending: str = ""
    _pending_s: float = 0.0
    _registered_s: float = float("-inf")
    _rearmed: RearmAnswer | None = None

    def peers(self, names: Sequence[str], last_end: str | None) -> None:
        """Report who has connected, and who has gone and why."""
        for name in names:
            if name not in self._peers:
                self.say(f"connected: {name}")
        for name in self._peers:
            if name not in names:
                why = last_end if last_end is not None and last_end.startswith(name) else name
                self.say(f"disconnected: {why}")
        self._peers = tuple(names)

    def state(self, state: GuidanceState) -> None:
        """Report a new state with its reasons, a registration, and the answer to a re-arm."""
        if self._begin_s is None:
            self._begin_s = state.now_s
            self.say("the first pose of the tool has come: the session runs")
        at = f"{state.now_s - self._begin_s:.1f} s"
        record = state.registration
        if record is not None and record.asked_s > self._registered_s:
            self._registered_s = record.asked_s
            bound = None if record.result is None else record.result.tre_bound_mm
            stated = "" if bound is None else f", largest error below {bound:.1f} mm (95 %)"
            self.say(f"{at}: registration: {record.reason}{stated}")
        if state.rearmed is not None and state.rearmed is not self._rearmed:
            self.say(f"{at}: re-arm: {state.rearmed.value}")
        self._rearmed = state.rearmed
        phrase, latched = _phrase_of(state.supervisor), state.supervisor is SupervisorState.LATCHED
        if phrase != self._pending:
            self._pending, self._pending_s = phrase, state.now_s
        if phrase == self._phrase or (not latched and state.now_s - self._pending_s < LASTS_S):
            return
        self._phrase = phrase
        why = "; ".join(state.reasons)
        sentence = f"{at}: {phrase}" + (f": {why}" if why and phrase != FORCE_GIVEN else "")
        self.say(f"{sentence}; {REARM}" if latched else sentence)


FORCE_GIVEN = "force is given"


def _phrase_of(supervisor: SupervisorState) -> str:
    if supervisor is SupervisorState.LATCHED:
        return "LATCHED, no force"
    return "no force" if supervisor is SupervisorState.FADE else FORCE_GIVEN


@contextmanager
def narrated(look: Callable[[], None]) -> Iterator[None]:
    """Call `look` every LOOK_EVERY_S in a thread of its own; the session's formats and writes nothing."""
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(LOOK_EVERY_S):
            look()

    thread = threading.Thread(target=run, name="dvf-ig narrator", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        look()


@dataclass(slots=True)
class _Kind:
    """Sentences that differ in their numbers alone: how many came, how many were shown, the last one."""

    count: int = 0
    reported: int = 0
    last: str = ""


class CountedSentences:
    """Show a sentence if it is the first, the tenth, the hundredth … of its kind.

    Args:
        tell: called with a sentence; from any thread.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._kinds: dict[str, _Kind] = {}
        self._others = 0
        self._changed = threading.Lock()

    def __call__(self, sentence: str) -> None:
        key = _NUMBERS.sub("0", sentence)
        with self._changed:
            if key not in self._kinds and len(self._kinds) >= MOST_KINDS:
                self._others += 1
                return
            kind = self._kinds.setdefault(key, _Kind())
            kind.count, kind.last = kind.count + 1, sentence
            if kind.count < 10 * kind.reported:
                return
            kind.reported = kind.count
        self._tell(_counted(kind))

    def finish(self) -> None:
        """Tell how often those came that have come again since."""
        with self._changed:
            kinds = [kind for kind in self._kinds.values() if kind.count > kind.reported]
        for kind in kinds:
            self._tell(_counted(kind))
        if self._others:
            self._tell(f"{self._others} more sentences of other kinds are not shown")


def _counted(kind: _Kind) -> str:
    return kind.last if kind.count == 1 else f"{kind.last} ({kind.count} times)"


@contextmanager
def counted(tell: Callable[[str], None]) -> Iterator[CountedSentences]:
    """Sentences of a session, counted until its end."""
    sentences = CountedSentences(tell)
    try:
        yield sentences
    finally:
        sentences.finish()
