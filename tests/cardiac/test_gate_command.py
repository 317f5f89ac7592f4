"""`dvf-ig gate`: fixed JSON names, files, exit codes."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import Signal
from dvf_ig.io import write_ecg_csv


@pytest.fixture
def ecg(tmp_path: Path) -> Path:
    t = np.arange(5000) / 250.0
    x = np.exp(-0.5 * (((t + 0.4) % 0.8 - 0.4) / 0.012) ** 2)
    x += 0.01 * np.random.default_rng(0).standard_normal(len(t))
    path = tmp_path / "ecg.csv"
    write_ecg_csv(Signal(x[:, None], 250.0, 0.0, ("II",)), path)
    return path


def test_json_names_and_file(ecg: Path, tmp_path: Path) -> None:
    out = tmp_path / "gate.json"
    done = CliRunner().invoke(app, ["gate", f"csv:{ecg}", "--phase-at", "50", "--json", "-o", str(out)])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert set(result) >= {
        "beats_s",
        "detected_at_s",
        "rate_bpm",
        "valid_share",
        "invalid_segments_s",
        "phase",
    }
    assert set(result["phase"]) == {"t_s", "phi", "valid"}
    assert len(result["phase"]["phi"]) == 1000
    assert result["rate_bpm"] == pytest.approx(75, abs=1)
    assert json.loads(out.read_text()) == result


def test_an_ecg_without_beats_exits_3(tmp_path: Path) -> None:
    path = tmp_path / "flat.csv"
    write_ecg_csv(Signal(np.zeros((2500, 1)), 250.0, 0.0, ("II",)), path)
    out = tmp_path / "gate.json"
    done = CliRunner().invoke(app, ["gate", f"csv:{path}", "-o", str(out)])
    assert done.exit_code == 3
    assert "0 R peaks" in done.output
    assert not out.exists()
