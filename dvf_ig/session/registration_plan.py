"""When the next registration begins, from which frames, and at which pose."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from dvf_ig.cardiac import RPeak
from dvf_ig.core import InvalidInputError, Landmarks, Points, Rigid, TouchedPoints, Warp
from dvf_ig.registration import LandmarkPrior, pose_through, prior_from_landmarks

from .events import Landmark
from .pose_states import InUse, Pose, under_test
from .pose_transition import RETRY_S, RegisterNext
from .ultrasound_registration import RegistrationRequest

FIRST_REGISTRATION_S = 8.0
"""The first registration begins when there is this much ultrasound."""
MEMORY_S = 12.0
"""How far back a registration looks: one refresh, so that a patient who moved is seen unmixed by the next."""


@dataclass(frozen=True, slots=True, eq=False)
class TouchedLandmarks:
    """Landmarks of one position of the patient: a start, a check of the first pose, and a prior.

    Attributes:
        marks: by name.
        fit: mr_from_tracker; None with fewer than three landmarks, or all on one line.
        prior: of registrations; None without a fit, or with too few landmarks.
    """

    marks: Mapping[str, Landmark] = field(default_factory=dict)
    fit: Rigid | None = field(init=False, default=None)
    prior: LandmarkPrior | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        if len(self.marks) < 3:
            return
        mr, tracker = self._pairs
        try:
            fit = pose_through(mr, tracker, None)
        except InvalidInputError:
            return  # all on one line; one more landmark may end that
        object.__setattr__(self, "fit", fit)
        object.__setattr__(self, "prior", prior_from_landmarks(mr, tracker))

    @property
    def _pairs(self) -> tuple[Landmarks, Landmarks]:
        """The landmarks in the MR and at the patient."""
        names, marks = tuple(self.marks), self.marks.values()
        mr = Landmarks(names, Points("mr", np.array([mark.mr_mm for mark in marks])))
        return mr, Landmarks(names, Points("tracker", np.array([mark.tracker_mm for mark in marks])))

    def fit_through(self, warp: Warp | None) -> Rigid | None:
        """Fit mr_from_tracker where a change of the heart's shape has taken the landmarks; None as `fit`.

        Raises:
            InvalidInputError: it has taken them onto one line.
        """
        if warp is None or self.fit is None:
            return self.fit
        return pose_through(*self._pairs, warp)

    def touched(self, landmark: Landmark) -> "TouchedLandmarks":
        """Add a landmark; one that is touched again replaces the older."""
        return TouchedLandmarks({**self.marks, landmark.name: landmark})

    def since(self, from_s: float) -> "TouchedLandmarks":
        """Forget those touched before: the patient or the probe's marker may have moved."""
        return TouchedLandmarks({name: mark for name, mark in self.marks.items() if mark.t_s >= from_s})


class RegistrationPlan:
    """The plan of the next registration, which actions of the pose's states change.

    Args:
        start: coarse pose that the first registrations begin at; None takes that of touched landmarks.
        touched: points touched on the heart's surface before.
    """

    def __init__(self, start: Rigid | None, touched: TouchedPoints | None = None) -> None:
        self.at_s = inf
        """When the next registration begins; infinite while none is planned."""
        self.landmarks = TouchedLandmarks()
        self._start, self._touched = start, touched
        self._frames_from_s = -inf
        self._beat_pose: Rigid | None = None
        """The best pose of the last beat, from when one suspended the pose in use until a registration."""

    def begin(self, event_s: float) -> None:
        """Plan the first registration; the first frame shows what happened at `event_s`."""
        self._frames_from_s, self.at_s = event_s, event_s + FIRST_REGISTRATION_S

    def change(self, action: RegisterNext) -> None:
        """Carry out an action of the pose's states."""
        self.at_s = action.at_s
        self._frames_from_s = max(self._frames_from_s, action.frames_from_s)
        if action.start is not None:
            self._beat_pose = action.start
        if action.forget_landmarks:
            self.landmarks, self._touched = self.landmarks.since(inf), None

    def add_landmark(self, landmark: Landmark) -> None:
        """Use a landmark that was touched."""
        self.landmarks = self.landmarks.touched(landmark)

    def follow_beat(self, best: Rigid) -> None:
        """Replace the best pose of the last beat, if the next registration begins there."""
        if self._beat_pose is not None:
            self._beat_pose = best

    def request(self, now_s: float, pose: Pose, peaks: tuple[RPeak, ...]) -> RegistrationRequest | None:
        """Begin the planned registration; None, and planned again, as long as there is no start pose."""
        self.at_s = inf
        start = self._start_pose(pose)
        if start is None:
            self.at_s = now_s + RETRY_S
            return None
        if isinstance(pose, InUse) and now_s >= pose.confirmation.until_s:
            self.landmarks, self._touched = self.landmarks.since(pose.confirmation.confirmed_s), None
        from_s = max(self._frames_from_s, now_s - MEMORY_S)
        prior = self.landmarks.prior
        if prior is not None and self._start is not None:
            prior = replace(prior, in_search=False)
        return RegistrationRequest(from_s, now_s, *start, prior, peaks, self._touched)

    def _start_pose(self, pose: Pose) -> tuple[Rigid, bool] | None:
        """Return where a registration begins, and whether that is relied on; None if nothing is known.

        Right after a suspension it is the last beat's best pose; once such a start has failed, displaced
        copies of the last pose are also tried.
        """
        estimate = under_test(pose)
        if estimate is None:
            start = self._start or self.landmarks.fit
            return None if start is None else (start, False)
        if isinstance(pose, InUse):
            return estimate.pose, True
        if self._beat_pose is not None:
            beat_pose, self._beat_pose = self._beat_pose, None
            return beat_pose, True
        return estimate.pose, False
