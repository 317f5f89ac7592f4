"""`serve` as a program of its own under faults of `scripts/fuzz --live`: how it ends."""

from dataclasses import replace
from pathlib import Path

from scripts.fuzz_live import faults, recording, run_fault

FAULTS = {fault.name: fault for fault in faults()}


def test_serve_ends_in_a_stated_state_without_force(tmp_path: Path) -> None:
    """Nobody reads its terminal and it is slow to end at Ctrl-C.

    Whether a force is given meanwhile depends on the machine, and is not asked here.
    """
    slow, unread = FAULTS["slow to end at Ctrl-C"], FAULTS["terminal that is not read"]
    done = run_fault(replace(unread, act=slow.act), tmp_path, recording())
    assert done.wrong_at_end == (), done
    assert (done.last_state, done.last_n) == ("LATCHED", 0.0)
