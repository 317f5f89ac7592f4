"""What a command writes never takes the place of a link, pipe, device, folder, input or somebody's file."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.core import TyperGroup, TyperOption
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.io import write_text
from dvf_ig.io.provenance import recorded_inputs

ECG = "t_s,II\n" + "".join(f"{i / 250},{i % 200 == 9:d}\n" for i in range(3000))
OF_ONE_FILE = ("gate", "view", "export", "config", "model", "calibrate")
FOLDERS = ("export slicer", "model export")
CHOICES = {"synth calibration": "pivot", "study calibration": "nwire", "study operators": "cutting"}
ENDINGS = {"export mcap": "x.mcap", "export rerun": "x.rrd"}


def writers() -> Iterator[tuple[str, Any]]:
    """Every command that has -o, with its words."""

    def walk(command: Any, words: str) -> Iterator[tuple[str, Any]]:
        if isinstance(command, TyperGroup):
            for name, below in command.commands.items():
                yield from walk(below, f"{words} {name}".strip())
        elif any("--out" in one.opts for one in command.params):
            yield words, command

    return walk(typer.main.get_command(app), "")


WRITERS = dict(writers())


def invocation(words: str, out: Path) -> list[str]:
    """The command with all that it requires, and -o."""
    arguments = words.split()
    for one in WRITERS[words].params:
        if not one.required or "--out" in one.opts:
            continue
        values = [CHOICES.get(words, "no_such_file")] * max(1, one.nargs)
        arguments += [one.opts[0], *values] if isinstance(one, TyperOption) else values
    return [*arguments, "-o", str(out)]


def contents(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): path.read_text() if path.is_file() else "-"
        for path in sorted(folder.rglob("*"))
    }


def test_commands_that_write_are_known() -> None:
    assert len(WRITERS) > 25
    assert {"gate", "register", "replay", "serve", "model build", "config init", "study hearts"} <= set(
        WRITERS
    )


@pytest.mark.parametrize("words", WRITERS)
def test_no_place_that_is_not_free_is_taken(words: str, tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    name = ENDINGS.get(words, "x")
    os.mkfifo(tmp_path / name)
    (own / name).symlink_to(tmp_path / "elsewhere")
    for out in (tmp_path / name, own / name, Path("/dev/null"), Path("/dev/stdout")):
        before = contents(tmp_path)
        done = CliRunner().invoke(app, invocation(words, out))
        assert done.exit_code == 4, (out, done.output)
        assert done.stderr.startswith("error: cannot write"), done.stderr
        assert "a link to" in done.stderr or "device or a pipe" in done.stderr
        assert contents(tmp_path) == before


@pytest.mark.parametrize("words", WRITERS)
def test_somebodys_file_stays(words: str, tmp_path: Path) -> None:
    """A file where a file or a folder is to be written."""
    out = tmp_path / ENDINGS.get(words, "mine.tfm" if words == "register" else "mine")
    out.write_text("mine")
    done = CliRunner().invoke(app, invocation(words, out))
    assert done.exit_code == 4, done.output
    assert "that this program did not write" in done.stderr or "it is a file" in done.stderr
    assert contents(tmp_path) == {out.name: "mine"}


@pytest.mark.parametrize("words", WRITERS)
def test_a_name_that_no_file_can_have_is_refused_before_the_work(words: str, tmp_path: Path) -> None:
    for name in ("x" * 300 + ENDINGS.get(words, "x"), "心臓" * 50 + ENDINGS.get(words, "x")):
        done = CliRunner().invoke(app, invocation(words, tmp_path / name))
        assert done.exit_code == 4, (name, done.output)
        assert done.stderr.startswith("error: cannot write"), done.stderr
        assert contents(tmp_path) == {}


@pytest.mark.parametrize("words", [words for words in WRITERS if words.split()[0] in OF_ONE_FILE])
@pytest.mark.parametrize("out", [".", "..", "folder"])
def test_a_folder_is_no_file(words: str, out: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, invocation(words, Path(out)))
    if words not in FOLDERS:
        assert done.exit_code == 4, done.output
        assert f"cannot write {out}: it is a folder; give a file name" in done.stderr
    assert contents(tmp_path) == {"folder": "-"}


@pytest.mark.parametrize("made_here", [False, True])
@pytest.mark.parametrize("out", ["mine.csv", "./mine.csv", "twin.csv"])
def test_an_input_is_never_the_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: str, made_here: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    if made_here:
        with recorded_inputs():
            write_text(Path("mine.csv"), ECG)
    else:
        Path("mine.csv").write_text(ECG)
    Path("twin.csv").hardlink_to("mine.csv")
    before = contents(tmp_path)
    done = CliRunner().invoke(app, ["gate", "csv:mine.csv", "-o", out])
    assert done.exit_code == 4, done.output
    assert contents(tmp_path) == before


def test_what_was_written_is_replaced_until_somebody_changes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("ecg.csv").write_text(ECG)
    words = ["gate", "csv:ecg.csv", "-o", "gate.json"]
    assert [CliRunner().invoke(app, words).exit_code for _ in range(2)] == [0, 0]
    with Path("gate.json").open("a") as stream:
        stream.write("\n")
    assert CliRunner().invoke(app, words).exit_code == 4
    done = CliRunner().invoke(app, ["gate", "csv:ecg.csv", "-o", "gate.png"])
    assert done.exit_code == 4
    assert "two results would have this name" in done.stderr


def test_what_nobody_foresaw_ends_in_a_sentence_and_a_log(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom dvf_ig.cli import main\n"
        "def failing(): raise ZeroDivisionError('division by zero')\n"
        "main.app = failing\nsys.argv = ['dvf-ig', 'gate']\nmain.run()\n"
    )
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 70
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "ZeroDivisionError" in done.stderr
    (log,) = tmp_path.iterdir()
    assert str(log) in done.stderr
    assert "division by zero" in log.read_text()
