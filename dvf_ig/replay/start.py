"""The pose that a recorded intervention's registration starts from, and the landmarks that check it."""

from dvf_ig.core import InvalidInputError, Rigid, Scenario
from dvf_ig.registration import LandmarkPrior, prior_from_landmarks, start_from_landmarks


def start_pose(scenario: Scenario) -> Rigid:
    """The operator's coarse pose, else the landmark fit.

    Raises:
        InvalidInputError: the scenario holds neither.
    """
    if scenario.start is not None:
        return scenario.start
    touched = landmark_pose(scenario)
    if touched is not None:
        return touched
    raise InvalidInputError(
        "the scenario has neither a start pose nor landmarks; add start.tfm, or landmarks_mr.mrk.json and "
        "landmarks_tracker.mrk.json"
    )


def landmark_pose(scenario: Scenario) -> Rigid | None:
    """The landmark fit, where landmarks were touched."""
    if scenario.landmarks_mr is None or scenario.landmarks_tracker is None:
        return None
    return start_from_landmarks(scenario.landmarks_mr, scenario.landmarks_tracker).mr_from_tracker


def landmark_prior(scenario: Scenario) -> LandmarkPrior | None:
    """Landmarks take part where the start came from them; a start pose takes their place."""
    if scenario.start is not None or scenario.landmarks_mr is None or scenario.landmarks_tracker is None:
        return None
    return prior_from_landmarks(scenario.landmarks_mr, scenario.landmarks_tracker)
