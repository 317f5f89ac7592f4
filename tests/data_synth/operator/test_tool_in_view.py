"""Looks at the tool bring its tip into the image, and leave the sweep alone otherwise."""

import numpy as np
import pytest

from data_synth.operator.tool_in_view import LookSpec, looking_at
from dvf_ig.core import FloatArray, InvalidInputError

SPEC = LookSpec(for_s=3.0)
TIP = np.array([50.0, 60.0, -30.0])


def still(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.tile(np.eye(3), (len(t_s), 1, 1)), np.tile([1.0, 2.0, 3.0], (len(t_s), 1))


def seen(t_s: FloatArray, spec: LookSpec = SPEC) -> FloatArray:
    """(n, 3) the tip in the plane's frame."""
    path = looking_at(still, lambda t: np.tile(TIP, (len(t), 1)), spec, np.random.default_rng(1))
    rotations, places = path(t_s)
    np.testing.assert_allclose(places, still(t_s)[1])
    return np.asarray(np.einsum("nji,nj->ni", rotations, TIP - places))


def test_the_tip_lies_in_the_image_during_a_look() -> None:
    start = SPEC.first_s + SPEC.turn_s
    during = np.concatenate([np.linspace(start, start + SPEC.for_s, 60) + k * SPEC.every_s for k in range(8)])
    x, y, z = seen(during).T
    assert np.sqrt(np.mean(z**2)) == pytest.approx(SPEC.wander_mm, rel=0.4)
    # the hand's wander tilts the tip out of the image, not within it
    assert np.degrees(np.arctan2(np.abs(x), y)).max() <= SPEC.off_axis_deg + 0.1


def test_the_sweep_goes_on_before_and_between() -> None:
    between = SPEC.first_s + 2 * SPEC.turn_s + SPEC.for_s + 0.1
    untouched = seen(np.array([0.0, SPEC.first_s - 0.01, between, between + SPEC.every_s]))
    np.testing.assert_allclose(untouched, np.tile(TIP - [1.0, 2.0, 3.0], (4, 1)), atol=1e-9)


def test_a_look_is_turned_to_smoothly() -> None:
    t_s = np.arange(SPEC.first_s - 1, SPEC.first_s + SPEC.every_s, 0.01)
    step = np.linalg.norm(np.diff(seen(t_s), axis=0), axis=1)
    assert step.max() < 2.0


@pytest.mark.parametrize("wrong", [{"for_s": -1.0}, {"wander_mm": -1.0}, {"for_s": 6.0}])
def test_looks_that_cannot_be_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidInputError):
        LookSpec(**wrong)
