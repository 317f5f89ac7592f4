"""Tissue at simulated devices: what is rendered, what rest on a beating wall makes, who tells which."""

import numpy as np
import pytest

from dvf_ig.guidance import SupervisorState
from dvf_ig.guidance.tissue import TISSUES
from dvf_ig.study.tissue import BEATING_MM, correct_share, press, rest, tissue_wall

SOFT, STIFF = TISSUES[1], TISSUES[4]


def test_a_device_renders_the_commanded_stiffness_and_operators_tell_it() -> None:
    presses = [press(tissue_wall([one.words[0]]), "omni") for one in (SOFT, STIFF)]
    for one, pressed in zip((SOFT, STIFF), presses, strict=True):
        assert pressed.stiffness_n_per_mm == pytest.approx(one.stiffness_n_per_mm, rel=0.1)
    rng = np.random.default_rng(1)
    assert correct_share(presses[0], presses[1], 200, rng) > 0.95
    assert 0.3 < correct_share(presses[0], presses[0], 200, rng) < 0.7


def test_a_hand_at_rest_on_beating_tissue_makes_no_energy() -> None:
    record = rest(tissue_wall([STIFF.words[0]], BEATING_MM), "premium", 1.5)
    assert record.residual_mj.max() < 0.1
    assert (record.state[1000:] == SupervisorState.OK).all()
    # the wall passes under the tip and back: there is force in one part of the beat, none in the other
    pushed = np.linalg.norm(record.sent_n[-600:], axis=1)
    assert pushed.max() > 0.1
