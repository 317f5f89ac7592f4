"""Landmarks touched on the patient: a start, a check of the first pose, and a prior of registrations."""

from math import inf

import numpy as np

from dvf_ig.core import InvalidInputError, Landmarks, Points, Rigid
from dvf_ig.registration import LandmarkPrior, prior_from_landmarks, start_from_landmarks
from dvf_ig.session.events import Landmark


class TouchedLandmarks:
    """The landmarks of one position of the patient; a point that is touched again replaces the older one."""

    def __init__(self) -> None:
        self._touched: dict[str, Landmark] = {}
        self.fit: Rigid | None = None
        """mr_from_tracker; None with fewer than three points, or all on one line."""
        self.prior: LandmarkPrior | None = None

    def add(self, landmark: Landmark) -> None:
        """One more point, or the same point again."""
        self._touched[landmark.name] = landmark
        self._refit()

    def forget(self, before_s: float = inf) -> None:
        """The patient or the probe's marker may have moved since those before `before_s` were touched."""
        self._touched = {name: mark for name, mark in self._touched.items() if mark.t_s >= before_s}
        self._refit()

    def _refit(self) -> None:
        names = tuple(self._touched)
        if len(names) < 3:
            self.fit = self.prior = None
            return
        mr = Landmarks(names, Points("mr", np.array([self._touched[n].mr_mm for n in names])))
        tracker = Landmarks(names, Points("tracker", np.array([self._touched[n].tracker_mm for n in names])))
        self.fit = _fit(mr, tracker)
        self.prior = None if self.fit is None else prior_from_landmarks(mr, tracker)


def _fit(mr: Landmarks, tracker: Landmarks) -> Rigid | None:
    try:
        return start_from_landmarks(mr, tracker).mr_from_tracker
    except InvalidInputError:
        return None  # all on one line so far; one more point may end that
