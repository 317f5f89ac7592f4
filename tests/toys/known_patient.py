"""A patient whose pose is known at all times, and what ultrasound of that pose would say, as in a study."""

from typing import TypeAlias

from dvf_ig.core import Rigid
from dvf_ig.study.faults.streams import Coordinates, KnownBeat, at_rest, known_registration

DETECTION_S = 0.12
"""An R peak is detected so long after it."""

Patient: TypeAlias = Coordinates
still, registration = at_rest, known_registration


def known_beat(begin_s: float, end_s: float, pose: Rigid) -> KnownBeat:
    """A beat whose ultrasound shows where the patient was half-way through it."""
    return KnownBeat(begin_s, end_s, end_s + DETECTION_S, pose)
