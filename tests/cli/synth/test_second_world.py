"""`dvf-ig synth scenario --world second`: what it refuses, and its specification."""

from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from dvf_ig.cli.synth.commands import app

SECOND = ["scenario", "--world", "second"]


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["scenario", "--quality", "calm"], 2, "belongs to --world second"),
        ([*SECOND, "--preset", "ectopy"], 2, "takes --quality, --heart"),
        ([*SECOND, "--mismatch-mm", "1"], 2, "takes --quality, --heart"),
        ([*SECOND, "--heart", "large"], 3, "choose from standard"),
        ([*SECOND, "--seconds", "2"], 3, "needed 5 to 3600 s"),
        ([*SECOND, "--motion", "fast"], 3, "choose from paper5mm"),
        (SECOND, 2, "give a folder to write"),
    ],
)
def test_impossible_requests_end_with_one_sentence(options: list[str], code: int, words: str) -> None:
    done = CliRunner().invoke(app, options)
    assert done.exit_code == code
    assert words in " ".join(done.output.replace("│", " ").split())


def test_its_specification_can_be_printed_and_used_again(tmp_path: Path) -> None:
    options = [*SECOND, "--quality", "poor-image", "--seed", "5009", "--print-spec"]
    done = CliRunner().invoke(app, options)
    assert done.exit_code == 0
    spec = yaml.safe_load(done.output)
    assert (spec["world"], spec["quality"], spec["seed"]) == ("second", "poor-image", 5009)
    file = tmp_path / "spec.yaml"
    file.write_text(done.output)
    again = CliRunner().invoke(app, ["scenario", "--spec", str(file), "--print-spec"])
    assert again.output == done.output
