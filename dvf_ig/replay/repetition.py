"""A live session repeated from its record: the same events and questions in the same order, bit by bit.

A registration that ran in a thread was there when it was asked for the n-th time; here it is done when
it is asked for so often.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from typing import Generic, TypeVar

import numpy as np

from dvf_ig.core import DvfIgError, FloatArray, PhaseTrack
from dvf_ig.intake.live_record import LiveRecord
from dvf_ig.intake.session_log.live import STATE_COLUMNS
from dvf_ig.session import GuidanceState, Job, Session

from .ticks import Ticks

T = TypeVar("T")


def repeat(session: Session, record: LiveRecord, observe: Callable[[int, GuidanceState], None]) -> None:
    """Push and ask as the live session did; `observe` is called with each state and its number."""
    number, before_s = -1, -inf
    for step in record.steps:
        if isinstance(step, float):
            number, before_s = number + (step > before_s), step
            observe(number, session.state(step))
        else:
            with suppress(DvfIgError):
                session.push(*step)


class AsRecorded:
    """An executor whose results are there when they were in a live session.

    Args:
        refused: of each work that was found done, by its number, how often it was not before.
    """

    def __init__(self, refused: Mapping[int, int]) -> None:
        self._refused, self._count = refused, 0

    def submit(self, work: Callable[[], T]) -> Job[T]:
        number, self._count = self._count, self._count + 1
        return _Recorded(work, self._refused.get(number))


@dataclass(slots=True)
class _Recorded(Generic[T]):
    work: Callable[[], T]
    refused: int | None
    asked: int = 0

    def done(self) -> bool:
        self.asked += 1
        return self.refused is not None and self.asked > self.refused

    def result(self) -> T:
        return self.work()


def recorded_ticks(record: LiveRecord) -> Ticks:
    """Return the answers of a live session, as they were recorded."""
    rows = record.last_states
    columns = dict(zip(STATE_COLUMNS, rows.T, strict=True))

    def vector(form: str) -> FloatArray:
        return np.column_stack([columns[form.format(axis)] for axis in "xyz"])

    first = STATE_COLUMNS.index("mr_from_tracker_00")
    t_s, codes = columns["t_s"], rows[:, -4:-1].astype(np.int64)
    state = columns["phase_state"].astype(np.int64)
    return Ticks(
        phase=PhaseTrack(t_s, columns["phi"], columns["sigma_phi"], columns["rr_s"], state),
        model_phase=columns["model_phase"],
        mr_from_tracker=rows[:, first : first + 12].reshape(-1, 3, 4),
        pose_age_s=columns["pose_age_s"],
        pose_bound_mm=columns["tre_bound_mm"],
        tip_tracker_mm=vector("tip_tracker_{}_mm"),
        force_n=vector("force_tracker_{}_n"),
        wanted_n=vector("wanted_tracker_{}_n"),
        distance_mm=columns["distance_mm"],
        margin_mm=columns["margin_mm"],
        breath_phase=columns["breath_phase"],
        breath_mm=columns["breath_mm"],
        breath_state=columns["breath_state"].astype(np.int64),
        status=codes[:, 0],
        supervisor=codes[:, 1],
        hazards=codes[:, 2],
    )
