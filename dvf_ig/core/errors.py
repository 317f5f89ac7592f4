"""Tree of the errors that misuse and bad input raise.

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


class DvfIgError(ValueError):
    """Base of all errors that this package raises."""


class InvalidInputError(DvfIgError):
    """Input that cannot be used; the message says what, got, needed, and what to do."""


class FrameMismatchError(InvalidInputError):
    """Combination of two values whose coordinate frames do not match."""


class UnreadableFileError(InvalidInputError):
    """File that is missing, truncated, or not of the format it claims."""


class MissingDependencyError(DvfIgError):
    """Missing optional package or system library that a call needs."""


class OutputError(DvfIgError):
    """Result that could not be written."""


class NoOverlapError(DvfIgError):
    """Recordings or images that must share space or time, but do not."""


class NotConvergedError(DvfIgError):
    """Estimate that did not converge."""


class QualityGateError(DvfIgError):
    """Estimate that converged but must not be used because of its evidence."""
