"""Watchers of a session: a few at once, with one slot reserved for a page of this server."""

import threading
from dataclasses import dataclass, field

MOST_WATCHERS = 4
"""Largest number of watchers; one slot is reserved for a page of this server."""


@dataclass(slots=True, eq=False)
class Watcher:
    """Watcher that receives events until `gone` is set."""

    own_page: bool
    gone: threading.Event = field(default_factory=threading.Event)


class Watchers:
    """Registry that accepts and refuses watchers, from any thread."""

    def __init__(self) -> None:
        self._watching: list[Watcher] = []
        self._changed = threading.Lock()

    def __bool__(self) -> bool:
        return bool(self._watching)

    def begin(self, *, own_page: bool) -> Watcher | None:
        """Register a new watcher, or return None if no slot is free.

        Args:
            own_page: the request comes from a page of this server; the oldest other program is dropped for
                it.
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
        """Remove a watcher; a second call has no effect."""
        with self._changed:
            if watcher in self._watching:
                self._watching.remove(watcher)
