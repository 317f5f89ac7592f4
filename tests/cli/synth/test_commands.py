"""`dvf-ig synth scenario` refuses what it cannot make, before it computes anything."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from dvf_ig.cli.synth.commands import app

REAL = ["--anatomy", "surfaces", "--surfaces", ".", "--probe-path", "none.igs.mha"]


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--preset", "storm"], 3, "choose from calm"),
        (["--motion", "fast"], 3, "choose from paper5mm"),
        (["--seconds", "2"], 3, "needed 5 to 3600 s"),
        (["--ecg", "wfdb:101"], 2, "belong to --anatomy"),
        (["--anatomy", "surfaces"], 2, "needs --surfaces, --ecg and"),
        ([*REAL, "--ecg", "csv:beats.csv"], 3, "has no beat annotations"),
    ],
)
def test_impossible_requests_end_with_one_sentence(
    tmp_path: Path, options: list[str], code: int, words: str
) -> None:
    done = CliRunner().invoke(app, ["scenario", *options, "-o", str(tmp_path / "out")])
    assert done.exit_code == code
    assert words in " ".join(done.output.replace("│", " ").split())
    assert not (tmp_path / "out").exists()
