"""A cavity whose wall is not labelled is named: the surface that is guarded lies inside the heart there."""

import numpy as np
import pytest

from dvf_ig.preop.surface.chambers import missing_wall


@pytest.mark.parametrize(("wall", "missing"), [(2, False), (0, True)])
def test_a_cavity_without_a_wall_is_named(wall: int, missing: bool) -> None:
    """A right ventricle that lies against the septum for a third of its outline."""
    x, y = np.meshgrid(np.arange(40), np.arange(40), indexing="ij")
    septum = np.hypot(x - 14, y - 20) < 9
    cavity = (np.hypot(x - 24, y - 20) < 8) & ~septum
    own = (np.hypot(x - 24, y - 20) < 8 + wall) | septum
    stack = [np.repeat(one[:, :, None], 5, axis=2) for one in (cavity, own)]
    sentence = missing_wall("rv_blood", *stack)
    assert (sentence is not None) == missing
    if sentence is not None:
        assert "the wall of rv_blood is not labelled" in sentence


def test_the_ends_of_a_stack_are_no_missing_wall() -> None:
    """Blood reaches the basal slice, beyond which nothing is imaged."""
    cavity = np.zeros((20, 20, 3), dtype=np.bool_)
    cavity[6:14, 6:14, :2] = True
    organ = np.zeros_like(cavity)
    organ[4:16, 4:16, :] = True
    assert missing_wall("lv_blood", cavity, organ) is None
