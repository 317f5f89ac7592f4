"""Neighbouring places and phases get neighbouring forces, within bounds taken from the coefficients."""

import numpy as np
import pytest

from dvf_ig.guidance import Evaluator, ForceSamples, Gaussian, Sigmoid, check_continuity
from dvf_ig.guidance.continuity import force_bounds

BLENDS = ["force", "distance", "periodic"]
LAWS = [Sigmoid(), Sigmoid(2.0, 0.5, 1.0), Gaussian(3.0, 2.0, depth_mm=1.0), Gaussian(2.0, 0.5, 0.4)]


@pytest.mark.parametrize("blend", BLENDS)
@pytest.mark.parametrize("law", LAWS)
def test_no_pair_of_neighbours_exceeds_the_bound(ball, law, blend):
    found = check_continuity(Evaluator(ball, law, blend=blend), 20_000, np.random.default_rng(8))
    assert found.violations == 0
    assert 0.001 < found.largest_share <= 1.0
    assert found.pairs > 19_000
    assert found.across_switches > 6_000
    assert found.near_no_direction > 1_000


@pytest.mark.parametrize("blend", BLENDS)
def test_slopes_stay_within_the_bounds_and_come_near_the_law_s(ball, shell_points, blend):
    """Finite differences: never beyond the bound, and at the guarded depth as steep as the law."""
    evaluator = Evaluator(ball, Sigmoid(), blend=blend)
    bounds = force_bounds(evaluator)
    step = 1e-4
    phi = np.full(len(shell_points), 0.2)
    here = evaluator.force(shell_points, phi)
    normal = here.gradient / np.linalg.norm(here.gradient, axis=1, keepdims=True)
    there = evaluator.force(shell_points + step * normal, phi)
    slope = np.linalg.norm(there.force_n - here.force_n, axis=1) / step
    assert slope.max() <= bounds.per_mm
    assert slope.max() > 0.9 * Sigmoid().stiffness_n_per_mm
    later = evaluator.force(shell_points, phi + step)
    assert np.linalg.norm(later.force_n - here.force_n, axis=1).max() / step <= bounds.per_cycle


class Jumping(Evaluator):
    """A fixture whose force jumps by 1 mN at one phase."""

    def force(self, xyz_mm, model_phase):
        whole = super().force(xyz_mm, model_phase)
        late = np.asarray(model_phase) % 1.0 >= 0.3
        jump = np.where(late, 1e-3, 0.0)[:, None] * np.array([1.0, 0.0, 0.0])
        return ForceSamples(
            whole.frame, whole.force_n + jump, whole.distance_mm, whole.gradient, whole.status
        )


def test_a_jump_of_a_millinewton_is_found(ball):
    found = check_continuity(Jumping(ball, Sigmoid()), 20_000, np.random.default_rng(9))
    assert found.violations > 100
