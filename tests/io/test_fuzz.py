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


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("traits")
    write_trait_seeds(folder)
    return folder


@pytest.mark.parametrize("reader", TRAITS)
def test_traits_of_peoples_files_are_never_read_silently(seeds: Path, reader: str) -> None:
    silent, changed = silent_traits(reader, 5, 30, seeds)
    assert silent == []
    assert changed >= 15
