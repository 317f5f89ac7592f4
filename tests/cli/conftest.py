"""Recordings of every calibration as the command makes them, shared by all tests that read them back."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from dvf_ig.cli.main import app


@pytest.fixture(scope="session")
def calibration_recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of each kind, only to be read."""
    folder = tmp_path_factory.mktemp("calibrations")
    for kind in ("pivot", "nwire", "cross-wire", "wall", "watertank"):
        words = ["synth", "calibration", kind, "-o", str(folder / kind), "--seed", "5"]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
    return folder
