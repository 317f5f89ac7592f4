"""The pose that a registration starts from, and what was touched on the patient to check it."""

from functools import partial

import numpy as np

from dvf_ig.core import DvfModel, InvalidInputError, QualityGateError, Rigid, Scenario, TouchedPoints
from dvf_ig.registration import (
    LandmarkFit,
    LandmarkPrior,
    pose_through,
    prior_from_landmarks,
    require_on_model,
    require_unflipped,
    start_from_surface_points,
)
from dvf_ig.session import Heart

from .readers import StartFiles

NO_START = (
    "the recording has neither a start pose, nor landmarks, nor touched points; give a coarse "
    "mr_from_tracker (start.tfm), or the same landmarks marked on the model and touched on the patient "
    "(landmarks_mr.mrk.json, landmarks_tracker.mrk.json), or points touched all over the heart's surface"
)


Startable = Scenario | StartFiles
"""What holds something to start a registration from."""


def require_start(scenario: Startable) -> None:
    """Raise InvalidInputError if a scenario holds nothing to start a registration from."""
    if scenario.start is None and scenario.touched is None and landmark_pose(scenario) is None:
        raise InvalidInputError(NO_START)


def start_pose(scenario: Startable, heart: Heart, seed: int) -> Rigid:
    """Choose the operator's coarse pose, else the landmark fit, else the fit of touched points.

    Raises:
        InvalidInputError: the scenario holds none of them, they are too few, or one is flipped (RAS for LPS).
        QualityGateError: the touched points leave the pose open.
    """
    marked, at = scenario.landmarks_mr, scenario.landmarks_tracker
    if marked is not None:
        require_on_model(marked, heart.model)
    if scenario.start is not None and marked is not None and at is not None:
        require_unflipped(scenario.start, marked, at)
    stated = scenario.start if scenario.start is not None else landmark_pose(scenario)
    if stated is not None:
        return stated
    touched = touched_points(scenario, heart.model)
    if touched is None:
        raise InvalidInputError(NO_START)
    fit = start_from_surface_points(touched, heart.model, heart.center_mm, rng=np.random.default_rng(seed))
    if not fit.stop.usable:
        raise QualityGateError(f"no start: {fit.sentence}")
    return fit.target_from_source


def touched_points(scenario: Startable, model: DvfModel) -> TouchedPoints | None:
    """Points touched on the heart with their position in the cycle: end-diastole unless it was given."""
    if scenario.touched is None:
        return None
    phase = scenario.touched_phase
    at = float(model.timing.fractions[model.ed_phase]) if phase is None else phase
    return TouchedPoints(scenario.touched, np.full(len(scenario.touched), at))


def landmark_fit(scenario: Startable) -> LandmarkFit | None:
    """Return how the touched landmarks are fitted; None without any."""
    if scenario.landmarks_mr is None or scenario.landmarks_tracker is None:
        return None
    return partial(pose_through, scenario.landmarks_mr, scenario.landmarks_tracker)


def landmark_pose(scenario: Startable) -> Rigid | None:
    """Fit the touched landmarks; None without any."""
    fit = landmark_fit(scenario)
    return None if fit is None else fit(None)


def landmarks_start(scenario: Startable) -> bool:
    """Whether the start comes from touched landmarks; a session then fits them itself as they are touched."""
    return scenario.start is None and landmark_pose(scenario) is not None


def landmark_prior(scenario: Startable) -> LandmarkPrior | None:
    """Landmarks as a prior of the pose, or of the probe's calibration alone where a start is given.

    None without any, or with too few.
    """
    if scenario.landmarks_mr is None or scenario.landmarks_tracker is None:
        return None
    in_search = scenario.start is None
    return prior_from_landmarks(scenario.landmarks_mr, scenario.landmarks_tracker, in_search=in_search)
