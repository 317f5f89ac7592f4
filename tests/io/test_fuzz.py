"""A short run of `scripts/fuzz`: damaged files are read or refused in a sentence, also those found before."""

import os
import subprocess
import sys
from pathlib import Path


def test_damaged_files_are_read_or_refused() -> None:
    root = Path(__file__).parents[2]
    command = [sys.executable, "-m", "scripts.fuzz_run", "--once", "6", "--seed", "7"]
    environment = {**os.environ, "PYTHONPATH": str(root / "tests" / "toys")}
    done = subprocess.run(
        command, cwd=root, env=environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stderr[-2000:]
