"""What a session still lacks for a registration, and for a force."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.intake.parts import SessionParts, StartFiles
from dvf_ig.intake.problem import Problem, Use


@dataclass(frozen=True, slots=True)
class _Need:
    """A part by its key, what it is needed for, whether it is there, and how to come by it."""

    key: str
    use: Use
    is_there: Callable[[SessionParts], bool]
    sentence: str

    def absent_from(self, document: Mapping[str, Any]) -> bool:
        """Whether the content of a SESSION.yaml does not name the part."""
        section, _, entry = self.key.partition(".")
        given = document.get(section)
        return given is None or (bool(entry) and isinstance(given, dict) and given.get(entry) is None)


def _has_start(start: StartFiles) -> bool:
    return start.start is not None or start.landmarks_mr is not None or start.touched is not None


NEEDS = (
    _Need(
        "preop",
        "register",
        lambda parts: parts.preop is not None,
        "a registration needs the heart: its model (dvf-ig model build … -o heart.npz), labels, or surfaces",
    ),
    _Need(
        "ecg",
        "register",
        lambda parts: parts.ecg is not None,
        "a registration needs the ECG, which tells when in the cycle each image was taken",
    ),
    _Need(
        "calibration.probe",
        "register",
        lambda parts: parts.probe is not None,
        "a registration needs the probe's calibration: dvf-ig calibrate probe SWEEP --device-set XML "
        "-o probe.json",
    ),
    _Need(
        "calibration.latency",
        "register",
        lambda parts: parts.latency is not None,
        "a registration needs the latency of the images: dvf-ig calibrate latency TRACKER VIDEO "
        "-o latency.json, or seconds where it is known",
    ),
    _Need(
        "start",
        "register",
        lambda parts: _has_start(parts.start),
        "a registration needs a start: a coarse mr_from_tracker (.tfm), or three landmarks or more marked on "
        "the model and touched on the patient, or points touched all over the heart's surface",
    ),
    _Need(
        "tool",
        "replay",
        lambda parts: parts.tool is not None,
        "a force needs the tool's poses: a tracked sequence of the tool on the ECG's clock",
    ),
    _Need(
        "calibration.tip",
        "replay",
        lambda parts: parts.tip is not None,
        "a force needs a tool tip: dvf-ig calibrate pivot POSES -o tip.json",
    ),
)


REQUIRED = ("preop", "calibration.probe", "calibration.latency")
"""Keys without which a SESSION.yaml describes no session; the ECG may be in the ultrasound."""


def missing_parts(parts: SessionParts, told: tuple[Problem, ...] = ()) -> tuple[Problem, ...]:
    """What is not there.

    Args:
        told: problems that are known; nothing more is said of a part that one of them is about.
    """
    return tuple(
        Problem(need.key, InvalidInputError(need.sentence), need.use)
        for need in NEEDS
        if not need.is_there(parts) and not any(problem.key.startswith(need.key) for problem in told)
    )
