"""Content of the page of a registration: plain text, numbers and planes."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from dvf_ig.core import RAS_FROM_LPS, FloatArray, read_only_arrays
from dvf_ig.report.plane_overlay import PlaneOverlay

from .shape import ShapeShown


class Outcome(Enum):
    """Outcome of a check; each value is the displayed text."""

    PASSED = "✓ passed"
    FAILED = "✕ failed"
    SHOWN = "no limit, for information"
    RIGID = "✕ guarded as rigid"
    NOT_CHECKED = "– not checked"


@dataclass(frozen=True, slots=True)
class Check:
    """One check of the pose.

    Attributes:
        name: short title.
        measures: the measured quantity, in a clause.
        value: as text with its unit; empty if not checked.
        limit: as text; empty without one.
        outcome: of the check.
    """

    name: str
    measures: str
    value: str
    limit: str
    outcome: Outcome


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """The registered pose and its file.

    Attributes:
        target, source: frames; the matrix maps points of the source to the target.
        target_name, source_name: content of those frames, for example "the MR image".
        matrix: (4, 4) mm, LPS.
        file: name of the ITK transform file.
    """

    target: str
    source: str
    target_name: str
    source_name: str
    matrix: FloatArray
    file: str

    @property
    def slicer_matrix(self) -> FloatArray:
        """Matrix (4, 4) that 3D Slicer shows for the file: the inverse ("to parent"), in RAS."""
        return np.asarray(RAS_FROM_LPS @ np.linalg.inv(self.matrix) @ RAS_FROM_LPS)


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationPage:
    """Content of the page.

    Attributes:
        title: the data that were registered.
        about: patient and program version.
        usable: whether the pose may be used.
        reason: for `usable`, in one clause.
        stated: rows of what is stated about the error, and its value or why there is none.
        planes: ultrasound planes before and after registration.
        anatomy: pre-operative image in the planes, for example "MR".
        remark: a remark on the planes; may be empty.
        checks: the evidence.
        findings: rows of quantity, value, meaning.
        data: rows of registered data and their amount.
        transform: the pose.
        made: rows on the computation.
        view: file name of the interactive page; empty without one.
        shape: change of the heart's shape; None if none was found.
    """

    title: str
    about: str
    usable: bool
    reason: str
    stated: Sequence[tuple[str, str]]
    planes: Sequence[PlaneOverlay]
    anatomy: str
    remark: str
    checks: Sequence[Check]
    findings: Sequence[tuple[str, str, str]]
    data: Sequence[tuple[str, str]]
    transform: Transform
    made: Sequence[tuple[str, str]]
    view: str = ""
    shape: ShapeShown | None = None
