"""Every command that writes has `-o/--out`; the former `--output` ends with 2 and says the new name."""

from collections.abc import Iterator
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from dvf_ig.cli.main import app


def commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command of the group and of its groups, with its words."""
    for name, found in group.commands.items():
        if hasattr(found, "commands"):
            yield from commands(found, (*path, name))
        else:
            yield (*path, name), found


WRITERS = [
    path
    for path, found in commands(typer.main.get_command(app))
    if any("-o" in option.opts for option in found.params)
]


@pytest.mark.parametrize("path", WRITERS, ids=" ".join)
def test_the_output_option_has_one_name(path: tuple[str, ...]) -> None:
    done = CliRunner().invoke(app, [*path, "--output", "somewhere"], env={"COLUMNS": "120"})
    assert done.exit_code == 2
    assert "No such option: --output" in done.output
    assert "--out" in done.output.replace("--output", "")
