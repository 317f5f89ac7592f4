"""`serve` as a program of its own under some of the faults of `scripts/fuzz --live`: how it ends."""

from pathlib import Path

import pytest

from scripts.fuzz_live import faults, recording, run_fault


@pytest.mark.parametrize("name", ["the program fails", "terminal that is not read", "slow to end at Ctrl-C"])
def test_serve_ends_in_a_stated_state_without_force(name: str, tmp_path: Path) -> None:
    """Whether a force is given meanwhile depends on the machine, and is not asked here."""
    fault = next(fault for fault in faults() if fault.name == name)
    done = run_fault(fault, tmp_path, recording())
    assert done.wrong_at_end == (), done
    assert (done.last_state, done.last_n) == ("LATCHED", 0.0)
