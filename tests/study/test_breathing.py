"""The study of breaths: an event is withheld, a still heart is left alone, and both have a row."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.io import read_json
from dvf_ig.study import breathing


def test_the_command_follows_every_way_and_says_what_it_served(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ways = {name: breathing.WAYS[name] for name in ("disconnection", "no breathing")}
    monkeypatch.setattr(breathing, "WAYS", ways)
    options = ["--seconds", "110", "--seeds", "1", "--workers", "1", "-o", str(tmp_path / "out")]
    done = CliRunner().invoke(app, ["study", "breathing", *options])
    assert done.exit_code == 0, done.output
    cut_off, still = read_json(tmp_path / "out" / "summary.json", "a summary")["rows"]
    assert 0.0 <= cut_off["withheld_s"] <= 0.3
    assert cut_off["largest_mm"] < 5.0
    assert still["largest_mm"] == 0.0
    assert not still["breathing_found"]
    assert "disconnection" in done.output
