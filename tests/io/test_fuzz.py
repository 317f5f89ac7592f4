"""A short run of `scripts/fuzz`: damaged files are read or refused in a sentence, also those found before."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from scripts.fuzz_traits import TRAITS, silent_traits, write_trait_seeds


def test_damaged_files_are_read_or_refused() -> None:
    root = Path(__file__).parents[2]
    command = [sys.executable, "-m", "scripts.fuzz_run", "--once", "6", "--seed", "7"]
    environment = {**os.environ, "PYTHONPATH": str(root / "tests" / "toys")}
    done = subprocess.run(
        command, cwd=root, env=environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stderr[-2000:]


@pytest.mark.parametrize("reader", TRAITS)
def test_traits_of_files_of_people_are_never_read_as_other_values(tmp_path: Path, reader: str) -> None:
    write_trait_seeds(tmp_path)
    silent, changed = silent_traits(reader, 5, 40, tmp_path)
    assert silent == []
    assert changed >= 20
