"""The heart that the operators work on, true and as the fixture knows it."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from data_synth.heart.motion import MotionPreset
from data_synth.operator.contact import MovingSurface
from data_synth.seeds import child_rng
from dvf_ig.core import DvfModel, FloatArray, Rigid
from dvf_ig.guidance import PoseAndPhase
from dvf_ig.study.passivity.pressing import steady_transform
from dvf_ig.study.stylus.holding import BeatingSurface, beating_surface

from .conditions import Condition

HEART_SEED, OTHER_HEART_SEED = 1001, 1002
"""Of the list TUNING (`dvf_ig.study.hearts.lists`)."""
MOTION: MotionPreset = "paper5mm"
CYCLE_S = 0.6
"""20 volumes T_d = 0.03 s apart, as in the paper."""
STILL_S = 1e9
"""A heart that stands still has a cycle of this length."""
ACCESS = np.array([0.6, -0.7, 0.2]) / np.linalg.norm([0.6, -0.7, 0.2])
"""From the heart towards the operator."""


@dataclass(frozen=True, slots=True)
class OperatingHeart:
    """True surface and its model.

    Attributes:
        truth: true surface over the cycle.
        model: fitted to 20 phases of it; the registration's error is separate.
        cycle_s: length of a beat.
    """

    truth: MovingSurface
    model: DvfModel
    cycle_s: float = CYCLE_S

    def cycle(self, condition: Condition) -> float:
        """Length of a cycle, s."""
        return self.cycle_s if condition.beating else STILL_S

    def phase(self, condition: Condition, t_s: float) -> float:
        """True phase."""
        return (t_s / self.cycle(condition)) % 1.0

    def fixture_model(self, condition: Condition) -> DvfModel:
        """This heart's, or another person's."""
        return surface_of(OTHER_HEART_SEED).model if condition.wrong_organ else self.model

    def transform(self, condition: Condition, seed: int) -> PoseAndPhase:
        """What a session would tell the servo: pose and phase with the condition's errors.

        Args:
            seed: of the operator; draws the direction of the registration's error.
        """
        model = self.fixture_model(condition)
        direction = child_rng(seed, "registration").standard_normal(3)
        shift = condition.registration_mm * direction / np.linalg.norm(direction)
        shift += model_center_mm(model) - model_center_mm(self.model)
        pose = Rigid(model.frame, "tracker", np.eye(3), shift)
        return steady_transform(
            model, pose=pose, rr_s=self.cycle(condition), phase_offset=condition.phase_error
        )


def operating_heart() -> OperatingHeart:
    """The heart of every trial."""
    surface = surface_of(HEART_SEED)
    return OperatingHeart(surface.truth, surface.model)


@cache
def surface_of(seed: int) -> BeatingSurface:
    """A phantom's true surface and its model, kept in the process; the worst of its places is the last."""
    return beating_surface(MOTION, cycle_s=CYCLE_S, seed=seed)


def model_center_mm(model: DvfModel) -> FloatArray:
    """(3,) mean of the reference surface's vertices at the first phase."""
    return np.asarray(model.reference[0].vertices_mm.mean(axis=0))
