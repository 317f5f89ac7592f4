"""The supervisor as a kernel, step by step against its readable form."""

import numpy as np
import pytest
from readable_supervisor import Supervisor

from dvf_ig.guidance import DeviceLimits, Hazard, RearmAnswer
from dvf_ig.guidance.servo.bound import REARM_ANSWERS, set_hazards, set_limits
from dvf_ig.kernels.servo import supervision as kernel
from dvf_ig.kernels.servo.layout import HAZARDS, LIMITS, new_memory


def arguments(device, walls):
    """Memory, limits and hazards of the kernel."""
    limits, hazards = np.zeros(1, LIMITS), np.zeros(1, HAZARDS)
    set_limits(limits, device)
    set_hazards(hazards, walls)
    return new_memory()["supervision"][0], limits[0], hazards[0]


def rough_session(seed, count):
    """(time, wanted, hazards, re-arm asked): drifting and jumping forces, hazards that come and go, NaN."""
    rng = np.random.default_rng(seed)
    t_s, wanted, hazards = 0.0, np.zeros(3), Hazard.NONE
    members = [hazard for hazard in Hazard if hazard is not Hazard.FORCE_CLAMPED]
    for _ in range(count):
        t_s += float(rng.choice([0.0, 0.001, 0.004]))
        wanted = wanted + rng.normal(scale=0.01, size=3) if rng.uniform() > 0.01 else rng.normal(size=3)
        wanted = wanted * min(1.0, 0.6 / max(float(np.linalg.norm(wanted)), 1e-9))
        hazards = Hazard.NONE if rng.uniform() < 0.02 else hazards
        hazards |= members[int(rng.integers(len(members)))] if rng.uniform() < 0.004 else Hazard.NONE
        given = wanted * (np.nan if rng.uniform() < 0.0005 else 0.1 if rng.uniform() < 0.3 else 1.0)
        yield t_s, given, hazards, rng.uniform() < 0.02


@pytest.mark.parametrize(("seed", "walls"), [(1, False), (2, True), (3, False)])
def test_the_kernel_s_supervisor_is_the_readable_one(seed, walls):
    limits = DeviceLimits(stiffness_n_per_m=300.0)
    readable, (memory, numbers, codes) = Supervisor(limits, walls=walls), arguments(limits, walls)
    states, answers = set(), set()
    for t_s, wanted, hazards, ask in rough_session(seed, 6000):
        expected = readable.step(t_s, wanted, hazards)
        kernel.supervise(memory, numbers, codes, t_s, wanted, int(hazards))
        np.testing.assert_allclose(memory["sent_n"], expected.force_n, atol=1e-12)
        found = tuple(memory[name] for name in ("state", "hazards", "cause", "clamped"))
        assert found == (expected.state, expected.hazards, expected.cause, expected.clamped)
        assert memory["scale"] == pytest.approx(expected.scale, abs=1e-12)
        states.add(expected.state)
        if ask:
            answer = REARM_ANSWERS[kernel.rearm(memory, numbers, codes, t_s + 0.01)]
            assert answer is readable.rearm(t_s + 0.01)
            answers.add(answer)
    assert len(states) == 4
    assert RearmAnswer.ACCEPTED in answers
    assert len(answers) > 2


def test_an_old_step_is_no_reason_to_rearm():
    readable, (memory, numbers, codes) = Supervisor(), arguments(DeviceLimits(), False)
    for k in range(30):
        hazards = Hazard.NOT_FINITE if k < 2 else Hazard.NONE
        readable.step(0.001 * k, np.zeros(3), hazards)
        kernel.supervise(memory, numbers, codes, 0.001 * k, np.zeros(3), int(hazards))
    assert memory["state"] == kernel.LATCHED
    assert (
        REARM_ANSWERS[kernel.rearm(memory, numbers, codes, 1.0)]
        is readable.rearm(1.0)
        is RearmAnswer.NO_RECENT_STEP
    )
