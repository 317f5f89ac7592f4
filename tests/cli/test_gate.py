"""`dvf-ig gate`: fixed JSON names, files, exit codes."""

import itertools
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
        "invalid_reasons",
        "leads",
        "left_out",
        "phase",
    }
    assert set(result["phase"]) == {"t_s", "phi", "valid"}
    assert len(result["phase"]["phi"]) == 1000
    assert len(result["invalid_reasons"]) == len(result["invalid_segments_s"])
    assert (result["leads"], result["left_out"]) == (["II"], [])
    assert result["rate_bpm"] == pytest.approx(75, abs=1)
    assert json.loads(out.read_text()) == result
    assert len(result["quality"]) == len(result["beats_s"])
    segments = result["state_segments"]
    assert [segments[0]["state"], segments[-1]["state"]] == ["INIT", "LOCKED"]
    assert all(a["stop_s"] == b["start_s"] for a, b in itertools.pairwise(segments))
    assert out.with_suffix(".png").read_bytes()[:4] == b"\x89PNG"


def test_a_lead_is_chosen_by_name(ecg: Path, tmp_path: Path) -> None:
    lines = ecg.read_text().splitlines()
    rows = ["t_s,II,ch1,ABP [mmHg]", *(f"{line},{line.split(',')[1]},80" for line in lines[1:])]
    (tmp_path / "ward.csv").write_text("\n".join(rows))
    for lead, left in (("II", ["ch1", "ABP"]), ("ch1", ["II", "ABP"])):
        done = CliRunner().invoke(app, ["gate", str(tmp_path / "ward.csv"), "--lead", lead, "--json"])
        result = json.loads(done.stdout)
        assert (result["leads"], result["left_out"]) == ([lead], left)
        shown = CliRunner().invoke(app, ["inspect", str(tmp_path / "ward.csv"), "--lead", lead, "--json"])
        assert json.loads(shown.stdout)["left_out"] == left
    refused = CliRunner().invoke(app, ["gate", str(tmp_path / "ward.csv"), "--lead", "ABP"])
    assert refused.exit_code == 3
    assert "ABP is in 'mmHg', which is no voltage" in refused.output
    assert "--lead" in refused.output


def test_a_trigger_is_an_equal_input(tmp_path: Path) -> None:
    path = tmp_path / "trigger.csv"
    path.write_text("t_s\n" + "\n".join(f"{0.8 * k + 0.02:.3f}" for k in range(40)) + "\n")
    arguments = ["gate", f"trigger:{path}", "--delay-s", "0.02", "--phase-at", "20", "--json"]
    done = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "out.json")])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["beats_s"] == pytest.approx([0.8 * k for k in range(40)])
    phase = result["phase"]
    late = np.array(phase["t_s"]) > 5.0
    assert np.array(phase["valid"])[late].all()
    error = np.array(phase["phi"]) - (np.array(phase["t_s"]) / 0.8) % 1.0
    assert np.abs((error[late] + 0.5) % 1.0 - 0.5).max() < 1e-6
    assert (tmp_path / "out.png").is_file()


def test_pulses_with_both_edges_are_told(tmp_path: Path) -> None:
    path = tmp_path / "trigger.csv"
    path.write_text("\n".join(f"{0.8 * k + edge:.3f}" for k in range(40) for edge in (0.0, 0.05)) + "\n")
    done = CliRunner().invoke(app, ["gate", f"trigger:{path}"])
    assert done.exit_code == 0, done.output
    assert "40 of 80 pulses come too soon after another" in done.output
    assert "0.0 % of the time" in done.output


def test_a_delay_without_a_trigger_exits_3(ecg: Path) -> None:
    done = CliRunner().invoke(app, ["gate", f"csv:{ecg}", "--delay-s", "0.02"])
    assert done.exit_code == 3
    assert "belongs to trigger:FILE" in done.output


def test_an_ecg_without_beats_exits_3(tmp_path: Path) -> None:
    path = tmp_path / "flat.csv"
    write_ecg_csv(Signal(np.zeros((2500, 1)), 250.0, 0.0, ("II",)), path)
    out = tmp_path / "gate.json"
    done = CliRunner().invoke(app, ["gate", f"csv:{path}", "-o", str(out)])
    assert done.exit_code == 3
    assert "0 R peaks" in done.output
    assert not out.exists()
