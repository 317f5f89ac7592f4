"""Who watches a session: a few at once, and a page of this server always finds a place."""

import threading
from dataclasses import dataclass, field

MOST_WATCHERS = 4
"""One of them is kept for a page that this server gave: other programs get no more than the rest."""


@dataclass(slots=True, eq=False)
class Watcher:
    """One that is sent events until `gone` is set."""

    own_page: bool
    gone: threading.Event = field(default_factory=threading.Event)


class Watchers:
    """Takes and turns away watchers; from any thread."""

    def __init__(self) -> None:
        self._watching: list[Watcher] = []
        self._changed = threading.Lock()

    def __bool__(self) -> bool:
        return bool(self._watching)

    def begin(self, *, own_page: bool) -> Watcher | None:
        """A new watcher, or None where there is no place for it.

        Args:
            own_page: a browser says that a page of this server asks; the oldest other program makes place.
        """
        with self._changed:
            others = [one for one in self._watching if not one.own_page]
            if len(others) >= MOST_WATCHERS - 1 and not own_page:
                return None
            if len(self._watching) >= MOST_WATCHERS:
                if not own_page or not others:
                    return None
                others[0].gone.set()
                self._watching.remove(others[0])
            watcher = Watcher(own_page)
            self._watching.append(watcher)
            return watcher

    def end(self, watcher: Watcher) -> None:
        """A watcher has gone; a second time does nothing."""
        with self._changed:
            if watcher in self._watching:
                self._watching.remove(watcher)
