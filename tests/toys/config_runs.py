"""Runs of `dvf-ig config`, and a SESSION.yaml to run it on."""

from pathlib import Path
from typing import Any

import yaml
from typer.testing import CliRunner, Result

from dvf_ig.cli.main import app


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["config", *map(str, arguments)])


def write(folder: Path, document: dict[str, Any]) -> Path:
    path = folder / "session.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def errors(done: Result) -> list[str]:
    """The sentences of a run that must have failed."""
    assert done.exit_code == 3, done.output
    lines = done.stderr.strip().splitlines()
    assert all(line.startswith("error: ") for line in lines), done.stderr
    return [line.removeprefix("error: ") for line in lines]
