"""Sentences about what cannot be used: each kind is said at once, and how often it came now and then."""

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

MOST_KINDS = 100
_NUMBERS = re.compile(r"\d[\d.,e+-]*")


@dataclass(slots=True)
class _Kind:
    """Sentences that differ in their numbers alone: how many came, how many were shown, the last one."""

    count: int = 0
    told: int = 0
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
            if kind.count < 10 * kind.told:
                return
            kind.told = kind.count
        self._tell(_counted(kind))

    def finish(self) -> None:
        """Tell how often those came that have come again since."""
        with self._changed:
            kinds = [kind for kind in self._kinds.values() if kind.count > kind.told]
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
