"""Tree of the errors that misuse and bad input raise, and the outcomes that are not errors.

    DvfIgError (a ValueError)
    ├── InvalidInputError        what the caller gave cannot be used; says what, got, needed, what to do
    │   ├── FrameMismatchError   frames of two values do not match
    │   └── UnreadableFileError  a file is missing, truncated, or not what its name says
    ├── MissingDependencyError   an optional package or a system library is absent
    ├── OutputError              a result could not be written
    ├── NoOverlapError           two things that must share space or time do not
    ├── NotConvergedError        an estimate did not converge; its evidence is kept
    └── QualityGateError         an estimate converged but must not be used; its evidence is kept

Expected numerical outcomes inside a method are `Stop` values, not exceptions.
"""

from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import Self

_AS_KEYS: Mapping[str, str] = MappingProxyType({})


class DvfIgError(ValueError):
    """Base of all errors that this package raises.

    Attributes:
        key: of a session.yaml, if the error concerns one, for example "calibration.tip".
        path: file or folder that the error concerns.
        settings: keys of a session.yaml that correct it; a command line shows its own options.
    """

    def __init__(
        self,
        message: str = "",
        *,
        key: str | None = None,
        path: Path | None = None,
        settings: Sequence[str] = (),
    ) -> None:
        super().__init__(message)
        self.key, self.path, self.settings = key, path, tuple(settings)

    def __str__(self) -> str:
        return self.sentence()

    @property
    def message(self) -> str:
        """Problem alone, without the settings that correct it."""
        return str(self.args[0]) if self.args else ""

    def sentence(self, spelled: Mapping[str, str] = _AS_KEYS) -> str:
        """Problem with the settings that correct it.

        Args:
            spelled: how the reader calls a setting, by its key; a setting that is not listed keeps its key.
        """
        named = ", ".join(spelled.get(key, key) for key in self.settings)
        return f"{self.message} ({named})" if named else self.message

    def concerning(self, key: str, path: Path | None = None) -> Self:
        """This error with its key and path, unless they are known already."""
        self.key, self.path = self.key or key, self.path or path
        return self


class InvalidInputError(DvfIgError):
    """Input that cannot be used; the message says what, got, needed, and what to do."""


class FrameMismatchError(InvalidInputError):
    """Combination of two values whose coordinate frames do not match."""


class UnreadableFileError(InvalidInputError):
    """File that is missing, truncated, or not of the format it claims."""


class MissingDependencyError(DvfIgError):
    """Missing optional package or system library that a call needs."""


def install_extra(extra: str) -> str:
    """Say how to install an optional part of this project, which no package index holds."""
    return f"install it with pip install '.[{extra}]' in the folder of dvf_ig's sources"


class OutputError(DvfIgError):
    """Result that could not be written."""


class NoOverlapError(DvfIgError):
    """Recordings or images that must share space or time, but do not."""


class NotConvergedError(DvfIgError):
    """Estimate that did not converge."""


class QualityGateError(DvfIgError):
    """Estimate that converged but must not be used because of its evidence."""


class Stop(Enum):
    """Outcome of an iterative estimate; the value is the sentence that a user reads."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "stopped at the iteration limit; the estimate may still be moving"
    MOVED_TOO_FAR = "the pose moved further from its start than a registration may; start closer and repeat"
    LOW_OVERLAP = "too little of the ultrasound falls on the model; sweep more of the heart or start closer"
    WEAK_GEOMETRY = "the data leave a direction undetermined; add views from other angles"
    AMBIGUOUS = "another pose explains the data about as well; add data or a start that tells them apart"
    POOR_MATCH = "image and model do not agree at the best pose found; do not guide by it"
    PHASE_OFFSET = "ECG and ultrasound disagree on the heart's phase; check the ECG's clock and latency"
    DOUBTFUL = "the checks together make a good pose too unlikely; do not guide by it"
    UNBOUNDED = (
        "nothing bounds the error of a heart that its images cover in part well enough to begin with it"
    )
    CHANGED_SHAPE = "the heart's shape differs too much from that in the pre-operative images to guide by it"
    DISAGREEMENT = "independent checks of the pose disagree; do not guide by it"

    @property
    def usable(self) -> bool:
        return self is Stop.CONVERGED
