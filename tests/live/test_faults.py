"""`serve` as a program of its own under some of the faults of `scripts/fuzz --live`: how it ends."""

from dataclasses import replace
from pathlib import Path

import pytest

from scripts.fuzz_live import Fault, faults, recording, run_fault

FAULTS = {fault.name: fault for fault in faults()}
FAILS, UNREAD, SLOW = "the program fails", "terminal that is not read", "slow to end at Ctrl-C"


@pytest.mark.parametrize(
    "fault", [FAULTS[FAILS], replace(FAULTS[UNREAD], act=FAULTS[SLOW].act)], ids=[FAILS, f"{UNREAD}, {SLOW}"]
)
def test_serve_ends_in_a_stated_state_without_force(fault: Fault, tmp_path: Path) -> None:
    """Whether a force is given meanwhile depends on the machine, and is not asked here."""
    done = run_fault(fault, tmp_path, recording())
    assert done.wrong_at_end == (), done
    assert (done.last_state, done.last_n) == ("LATCHED", 0.0)
