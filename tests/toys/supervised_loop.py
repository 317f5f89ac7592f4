"""A supervisor stepped once a millisecond, and the forces that tests ask of it."""

import numpy as np
from readable_supervisor import Supervisor

from dvf_ig.guidance import Hazard, SupervisorState

TICK_S = 0.001
CAP = 0.6
WANTED = np.array([0.36, -0.48, 0.0])
NONE = np.zeros(3)


class Loop:
    """A supervisor stepped once a millisecond; time never depends on a running sum."""

    def __init__(self, device=None):
        self.supervisor = Supervisor() if device is None else Supervisor(device)
        self.tick = 0

    @property
    def now_s(self):
        return self.tick * TICK_S

    def steps(self, count, wanted=WANTED, hazards=Hazard.NONE):
        out = []
        for _ in range(count):
            self.tick += 1
            out.append(self.supervisor.step(self.now_s, np.asarray(wanted, float), hazards))
        return out

    def rearm(self):
        return self.supervisor.rearm(self.now_s)


def guiding():
    """A loop whose force has caught up with the wanted one."""
    loop = Loop()
    last = loop.steps(200)[-1]
    assert last.state is SupervisorState.OK
    np.testing.assert_array_equal(last.force_n, WANTED)
    return loop


def latched():
    loop = guiding()
    loop.steps(40, hazards=Hazard.NOT_FINITE)
    assert loop.steps(1, wanted=NONE)[-1].state is SupervisorState.LATCHED
    return loop


def sizes(steps):
    return np.array([np.linalg.norm(s.force_n) for s in steps])
