"""Landmarks touched on the patient: a start, a check of the first pose, and a prior of registrations."""

import numpy as np

from dvf_ig.core import InvalidInputError, Landmarks, Points, Rigid
from dvf_ig.registration import LandmarkPrior, prior_from_landmarks, start_from_landmarks

from .events import Landmark


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
        names = tuple(self._touched)
        mr = Landmarks(names, Points("mr", np.array([self._touched[n].mr_mm for n in names])))
        tracker = Landmarks(names, Points("tracker", np.array([self._touched[n].tracker_mm for n in names])))
        self.fit = _fit(mr, tracker)
        self.prior = None if self.fit is None else prior_from_landmarks(mr, tracker)

    def forget(self) -> None:
        """The patient or the probe's marker has moved since they were touched."""
        self._touched.clear()
        self.fit = self.prior = None


def _fit(mr: Landmarks, tracker: Landmarks) -> Rigid | None:
    if len(mr.names) < 3:
        return None
    try:
        return start_from_landmarks(mr, tracker).mr_from_tracker
    except InvalidInputError:
        return None  # all on one line so far; one more point may end that
