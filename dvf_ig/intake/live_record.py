"""The record of a live session, beyond its recordings: everything that repeats the session."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.session import Event

from .findings import Finding

Arrived = tuple[Event, float | None]
"""An event, and when it came by the session's clock; None of what did not arrive."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LiveRecord:
    """Everything in the order in which it happened.

    Attributes:
        steps: events that were pushed, and between them moments at which the state was asked for.
        refused: of each work that was found done, by its number, how often it was not before.
        states: (n, columns of `session_log.live.STATE_COLUMNS`) what the session answered.
        seed: of the session.
        findings: what the record lacks.
    """

    steps: tuple[Arrived | float, ...]
    refused: Mapping[int, int]
    states: FloatArray
    seed: int
    findings: tuple[Finding, ...]

    @property
    def last_states(self) -> FloatArray:
        """The last of `states` at each moment: after a re-arming there may be two."""
        t_s = self.states[:, 0]
        return np.asarray(self.states[np.append(t_s[1:] > t_s[:-1], True)])
