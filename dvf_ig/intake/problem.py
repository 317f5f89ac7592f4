"""What keeps a session's recordings from being registered or replayed, told by the configuration's keys."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from dvf_ig.core.errors import DvfIgError

Use = Literal["register", "replay"]
KEYS = {
    "--probe-name": "ultrasound.probe_name",
    "--reference-name": "ultrasound.reference_name",
    "--rate": "ecg.rate_hz",
    "--ecg-start": "ecg.start_s",
    "--tool-name": "tool.name",
}
"""Options of the commands and keys of a SESSION.yaml that say the same."""


def in_keys(sentence: str) -> str:
    """A sentence with the keys in place of the options that it names."""
    for option, key in KEYS.items():
        sentence = sentence.replace(option, key)
    return sentence


def in_options(sentence: str) -> str:
    """A sentence with the options in place of the keys that it names."""
    for option, key in KEYS.items():
        sentence = sentence.replace(key, option)
    return sentence


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong or missing.

    Attributes:
        key: of the configuration, for example "calibration.tip".
        error: what is wrong and what to do.
        hinders: "register" where neither registration nor replay can go on, "replay" where that alone.
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
    """Collects problems where single reads and checks raise them.

    Attributes:
        files: keys and files; a problem has the key of the file that its sentence names.
    """

    files: Iterable[tuple[str, Path]] = ()
    found: list[Problem] = field(default_factory=list)

    @contextmanager
    def about(self, key: str, hinders: Use = "register") -> Iterator[None]:
        """A block that reads or checks what stands under a key; its errors are kept and not raised."""
        try:
            yield
        except DvfIgError as error:
            self.found.append(Problem(self._key_of(error, key), error, hinders))

    def _key_of(self, error: DvfIgError, section: str) -> str:
        inside = ((key, path) for key, path in self.files if key.startswith(section))
        return next((key for key, path in inside if str(path) in str(error)), section)
