"""Lines through the heart: as exact between the nodes as at them, at a fraction of the pull-backs."""

from dataclasses import dataclass

import numpy as np
import pytest

from data_synth.heart.anatomy import PhantomAnatomy
from data_synth.heart.motion import ES_FRACTION, PullBack
from data_synth.ultrasound.scan_lines import COARSE, TOLERANCE_MM, traced_lines
from dvf_ig.core import FloatArray, InvalidInputError

STEP_MM = 0.29
SAMPLES = 513


@dataclass
class Counting:
    """Passes points on and counts them."""

    motion: PullBack
    points: int = 0

    def pull_back(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        self.points += len(xyz_mm)
        return self.motion.pull_back(xyz_mm, model_phase)


def test_between_nodes_as_exact_as_at_them(anatomy: PhantomAnatomy) -> None:
    center = anatomy.box_mm.mean(axis=0)
    origin = center + 75 * np.array([0.52, -0.83, -0.2])
    direction = (center - origin) / 75 + 0.3 * np.random.default_rng(0).normal(size=(60, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = origin + STEP_MM * np.arange(SAMPLES)[:, None] * direction[:, None]
    phases = ES_FRACTION + np.linspace(-0.05, 0.05, 60)
    counting = Counting(anatomy.inverse_motion)
    path = traced_lines(counting, points, phases)
    assert path.shape == (60, SAMPLES, 3)
    exact = anatomy.inverse_motion.pull_back(points.reshape(-1, 3), np.repeat(phases, SAMPLES))
    # chords are checked at their middles, curvature adds to creases: within 0.05 mm in all
    assert np.linalg.norm(path - exact.reshape(path.shape), axis=2).max() < 0.05
    assert counting.points < 2.5 * path[..., 0].size / COARSE


def test_crease_is_found_wherever_it_lies() -> None:
    """A fold at x = c: slope 1 on one side, 2 on the other."""

    @dataclass
    class Fold:
        at_mm: float

        def pull_back(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
            out = np.array(xyz_mm)
            out[:, 0] += np.maximum(xyz_mm[:, 0] - self.at_mm, 0.0)
            return out

    points = np.arange(145)[:, None] * np.array([[0.1, 0, 0]])
    for at_mm in np.linspace(0.05, 14.0, 57):
        fold = Fold(float(at_mm))
        path = traced_lines(fold, points[None], np.zeros(1))[0]
        assert np.abs(path - fold.pull_back(points, 0.0)).max() <= TOLERANCE_MM + 1e-12


@pytest.mark.parametrize("count", [9, 16, 24])
def test_lines_that_cannot_be_halved_are_refused(anatomy: PhantomAnatomy, count: int) -> None:
    with pytest.raises(InvalidInputError, match="needed a multiple of 8, plus 1"):
        traced_lines(anatomy.inverse_motion, np.zeros((1, count, 3)), np.zeros(1))
