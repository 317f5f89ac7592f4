"""What the page of a registration is made from: plain text, numbers and planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.core.space.frames import RAS_FROM_LPS
from dvf_ig.report.plane_overlay import PlaneOverlay


class Outcome(Enum):
    """How a check ended; each value is what a reader sees."""

    PASSED = "✓ passed"
    FAILED = "✕ failed"
    SHOWN = "no limit, for information"
    NOT_CHECKED = "– not checked"


@dataclass(frozen=True, slots=True)
class Check:
    """One check of the pose.

    Attributes:
        name: short title.
        measures: what it measures, in a clause.
        value: as text with its unit; empty where it was not checked.
        limit: as text; empty without one.
        outcome: how it ended.
    """

    name: str
    measures: str
    value: str
    limit: str
    outcome: Outcome


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """The registered pose and the file that holds it.

    Attributes:
        target, source: frames; the matrix takes points of the source to the target.
        target_name, source_name: what lies in those frames, for example "the MR image".
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
        """(4, 4) what 3D Slicer shows of the file: the inverse ("to parent"), in RAS."""
        return np.asarray(RAS_FROM_LPS @ np.linalg.inv(self.matrix) @ RAS_FROM_LPS)


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationPage:
    """Everything on the page.

    Attributes:
        title: what was registered.
        about: whose it is and by which version.
        usable: whether the pose may be used.
        reason: why, in one clause.
        planes: ultrasound planes before and after registration.
        anatomy: what the planes show of the pre-operative data beside contours, for example "MR".
        remark: what a reader should know about that; empty where nothing.
        checks: the evidence.
        findings: rows of quantity, value, what it means.
        data: rows of what was registered, and how much of it.
        transform: the pose.
        made: rows of how it was computed.
        view: name of the interactive page beside it; empty without.
    """

    title: str
    about: str
    usable: bool
    reason: str
    planes: Sequence[PlaneOverlay]
    anatomy: str
    remark: str
    checks: Sequence[Check]
    findings: Sequence[tuple[str, str, str]]
    data: Sequence[tuple[str, str]]
    transform: Transform
    made: Sequence[tuple[str, str]]
    view: str = ""
