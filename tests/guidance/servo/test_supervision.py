"""The supervisor as a kernel, step by step against its readable form."""

import numpy as np
import pytest

from dvf_ig.guidance import DeviceLimits, Hazard, RearmAnswer, Supervisor
from dvf_ig.guidance.servo.bound import REARM_ANSWERS, hazard_codes, supervisor_limits
from dvf_ig.kernels.servo import supervision as kernel


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
    readable, memory = Supervisor(limits, walls=walls), np.zeros(kernel.MEMORY_SIZE)
    kernel.start_supervision(memory)
    numbers, codes = supervisor_limits(limits), hazard_codes(walls)
    states, answers = set(), set()
    for t_s, wanted, hazards, ask in rough_session(seed, 6000):
        expected = readable.step(t_s, wanted, hazards)
        kernel.supervise(memory, numbers, codes, t_s, wanted, int(hazards))
        np.testing.assert_allclose(memory[kernel.SENT : kernel.SENT + 3], expected.force_n, atol=1e-12)
        found = (memory[kernel.STATE], memory[kernel.HAZARDS], memory[kernel.CAUSE], memory[kernel.CLAMPED])
        assert found == (expected.state, expected.hazards, expected.cause, expected.clamped)
        assert memory[kernel.SCALE] == pytest.approx(expected.scale, abs=1e-12)
        states.add(expected.state)
        if ask:
            answer = REARM_ANSWERS[kernel.rearm(memory, numbers, codes, t_s + 0.01)]
            assert answer is readable.rearm(t_s + 0.01)
            answers.add(answer)
    assert len(states) == 4
    assert RearmAnswer.ACCEPTED in answers
    assert len(answers) > 2


def test_an_old_step_is_no_reason_to_rearm():
    readable, memory = Supervisor(), np.zeros(kernel.MEMORY_SIZE)
    kernel.start_supervision(memory)
    numbers, codes = supervisor_limits(DeviceLimits()), hazard_codes(False)
    for k in range(30):
        hazards = Hazard.NOT_FINITE if k < 2 else Hazard.NONE
        readable.step(0.001 * k, np.zeros(3), hazards)
        kernel.supervise(memory, numbers, codes, 0.001 * k, np.zeros(3), int(hazards))
    assert memory[kernel.STATE] == kernel.LATCHED
    assert (
        REARM_ANSWERS[kernel.rearm(memory, numbers, codes, 1.0)]
        is readable.rearm(1.0)
        is RearmAnswer.NO_RECENT_STEP
    )
