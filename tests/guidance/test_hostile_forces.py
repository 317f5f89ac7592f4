"""A short run of `scripts/fuzz --forces`, and what longer ones have found."""

import numpy as np
import pytest

from dvf_ig.guidance import Evaluator, Sigmoid, Status
from scripts.fuzz_forces import fuzz_forces


def test_forces_at_hostile_places_are_finite_and_within_their_cap() -> None:
    assert fuzz_forces(20_000, seed=7) == 0


@pytest.mark.parametrize("blend", ["force", "distance", "periodic"])
def test_a_phase_beyond_all_integers_is_one_of_the_cycle(ball, shell_points, blend) -> None:
    """The kernel's floor was an integer: at 1e19 it read outside the model's memory."""
    evaluator = Evaluator(ball, Sigmoid(), blend=blend)
    for phase in (1e19, -1e19, 1e300, -1e300, -5e-324):
        found = evaluator.force(shell_points, phase)
        assert (found.status == Status.OK).all()
        np.testing.assert_array_equal(found.force_n, evaluator.force(shell_points, phase % 1.0).force_n)
