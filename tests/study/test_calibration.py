"""Interval coverage: its arithmetic on made-up lines; a few real trials of each kind, by the command."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import InvalidInputError
from dvf_ig.study.calibration import calibration_trial, interval_coverage


def test_summary_counts_intervals_that_hold_the_truth() -> None:
    lines = [{"error": {"lag_ms": e}, "half_width": {"lag_ms": 1.0}} for e in (-2.0, -0.5, 0.0, 0.5)]
    (entry,) = interval_coverage([*lines, {"refused": "why"}])
    assert (entry.name, entry.intervals, entry.share) == ("lag_ms", 4, 0.75)
    assert entry.bias == pytest.approx(-0.5)
    assert entry.sd == pytest.approx(np.std([-2.0, -0.5, 0.0, 0.5], ddof=1))
    assert interval_coverage([{"refused": "why"}]) == []


def test_a_trial_is_reproducible_and_its_errors_are_small() -> None:
    settings = {"kind": "nwire", "method": "orthogonal"}
    first = calibration_trial(settings, 11)
    assert first == calibration_trial(settings, 11)
    assert first != calibration_trial(settings, 12)
    assert all(abs(first["error"][f"{axis}_mm"]) < 0.3 for axis in ("lateral", "axial", "elevation"))
    with pytest.raises(InvalidInputError, match="choose nwire"):
        calibration_trial({"kind": "pivot"}, 1)


@pytest.mark.parametrize("kind", ["nwire", "cross-wire", "wall", "watertank"])
def test_the_command_writes_lines_and_a_summary(kind: str, tmp_path: Path) -> None:
    arguments = ["study", "calibration", "--kind", kind, "--seeds", "4", "--seed", "1", "--workers", "1"]
    arguments += ["--json", "-o", str(tmp_path)]
    if kind == "nwire":
        arguments += ["--method", "orthogonal"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    summary = json.loads(done.stdout)
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    assert summary["refused"] == 0
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == 4
    names = [entry["name"] for entry in summary["coverage"]]
    assert names[0] == ("lag_ms" if kind == "watertank" else "position_mm")
    # 4 trials of 95 %: 3 numbers each, all but one in 12 as a rule
    assert summary["coverage"][0]["share"] >= 0.75
