"""Everything that can go wrong by misuse or bad input, as one tree.

    DvfIgError (a ValueError)
    ├── InvalidInputError        what the caller gave cannot be used; says what, got, needed, what to do
    │   ├── FrameMismatchError   frames of two values do not meet
    │   └── UnreadableFileError  a file is missing, truncated, or not what its name says
    ├── MissingDependencyError   an optional package or a system library is absent
    ├── OutputError              a result could not be written
    ├── NoOverlapError           two things that must share space or time do not
    ├── NotConvergedError        an estimate did not converge; its evidence is kept
    └── QualityGateError         an estimate converged but must not be used; its evidence is kept

Expected numerical outcomes inside a method are `Stop` values, not exceptions.
"""


class DvfIgError(ValueError):
    """Base of every error this package raises on purpose."""


class InvalidInputError(DvfIgError):
    """The input cannot be used; the message says what, got, needed, and what to do."""


class FrameMismatchError(InvalidInputError):
    """Two values whose coordinate frames do not meet were combined."""


class UnreadableFileError(InvalidInputError):
    """A file is missing, truncated, or not of the format it claims."""


class MissingDependencyError(DvfIgError):
    """An optional package or a system library that this call needs is absent."""


class OutputError(DvfIgError):
    """A result could not be written."""


class NoOverlapError(DvfIgError):
    """Two recordings or images that must share space or time do not."""


class NotConvergedError(DvfIgError):
    """An estimate did not converge."""


class QualityGateError(DvfIgError):
    """An estimate converged but its evidence forbids its use."""
