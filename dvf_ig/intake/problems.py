"""Problems that prevent a session from being registered or replayed, each with the key that it concerns."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from dvf_ig.core.errors import DvfIgError

Use = Literal["register", "replay"]


@contextmanager
def concerning(key: str, path: Path | None = None) -> Iterator[None]:
    """A block whose errors concern a key, and the file that it names."""
    try:
        yield
    except DvfIgError as error:
        error.concerning(key, path)
        raise


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong or missing.

    Attributes:
        key: of the configuration, for example "calibration.tip".
        error: what is wrong and what to do.
        hinders: "register" if neither registration nor replay can go on, "replay" if only that cannot.
    """

    key: str
    error: DvfIgError
    hinders: Use = "register"

    @property
    def sentence(self) -> str:
        return f"{self.key}: {self.error}"

    def concerns(self, use: Use) -> bool:
        """Whether this use of the recordings is hindered; what hinders a registration hinders a replay."""
        return self.hinders in ("register", use)


@dataclass(slots=True)
class ProblemList:
    """Problems, collected where single reads and checks raise them."""

    items: list[Problem] = field(default_factory=list)

    @contextmanager
    def about(self, key: str, hinders: Use = "register") -> Iterator[None]:
        """A block that reads or checks what a key names; its errors are kept and not raised."""
        try:
            with concerning(key):
                yield
        except DvfIgError as error:
            self.items.append(Problem(error.key or key, error, hinders))

    def within(self, key: str) -> bool:
        """Whether something is wrong with a key, or with one in its section."""
        return any(problem.key == key or problem.key.startswith(f"{key}.") for problem in self.items)
