"""`serve` as a program of its own under faults of `scripts/fuzz --live`: how it ends."""

from dataclasses import replace
from pathlib import Path

from scripts.fuzz_live import Case, faults, recording, run_fault

FAULTS = {fault.name: fault for fault in faults()}


def test_serve_ends_in_a_stated_state_without_force(tmp_path: Path) -> None:
    """It fails while nobody reads its terminal, and is slow to send its last messages.

    Whether a force is given meanwhile depends on the machine, and is not asked here.
    """
    slow, fails = FAULTS["slow to end at Ctrl-C"], FAULTS["the program fails"]

    def act(case: Case) -> None:
        for fault in (slow, fails):
            assert fault.act is not None
            fault.act(case)

    unread = replace(FAULTS["terminal that is not read"], act=act, code=fails.code, ends=True)
    done = run_fault(unread, tmp_path, recording())
    assert done.wrong_at_end == (), done
    assert (done.last_state, done.last_n) == ("LATCHED", 0.0)
