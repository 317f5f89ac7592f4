"""`dvf-ig study`: commands made from the settings of each study."""

import subprocess
import sys
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from dvf_ig.cli import study as command
from dvf_ig.cli.main import app
from dvf_ig.study.driver import Driver, Line, Result, Settings, Study, Trials, refusals
from dvf_ig.study.options import option, seeds_option

ONE_FILE = '''"""Multiply seeds.

The product of two whole numbers is whole.

    dvf-ig study product --factor 3 -o study
"""

STUDY = Study(Product, run)
'''


class Sign(StrEnum):
    """Sign of the factor."""

    plus = "plus"
    minus = "minus"


@dataclass(frozen=True, kw_only=True)
class Product:
    """Options of every kind."""

    factor: int = option("Number to multiply by.", least=1, most=9)
    sign: Sign = option("Its sign.", Sign.plus)
    powers: tuple[int, ...] = option("Powers to take.", (1, 2))
    name: tuple[str, ...] = option("May be given again.", (), flag="--label")
    voxel_mm: tuple[float, float, float] | None = option("Voxel size.", None)
    seeds: int = seeds_option(2)


def trial(settings: Settings, seed: int) -> Line:
    """Product of the factor and the seed."""
    return {"product": settings["factor"] * seed}


def run(settings: Product, driver: Driver) -> Result:
    """Multiply every seed."""
    fields: dict[str, Any] = {"factor": settings.factor}
    lines = driver.trials(Trials("product", fields, trial), range(1, 1 + settings.seeds))
    summary = {
        "products": [line["product"] for line in lines],
        "sign": settings.sign,
        "powers": settings.powers,
        "labels": settings.name,
        "voxel_mm": settings.voxel_mm,
    }
    return Result(summary, [("products", str(len(lines)))], {"summary.json": summary}, refusals(lines))


@pytest.fixture
def group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> command.StudyGroup:
    """A folder with one study in one file."""
    (tmp_path / "product.py").write_text(ONE_FILE)
    (tmp_path / "no_study.py").write_text('"""Something else."""')
    module = SimpleNamespace(STUDY=Study(Product, run))
    monkeypatch.setattr(command, "FOLDER", tmp_path)
    monkeypatch.setattr(command, "import_module", lambda _: module)
    return command.StudyGroup(name="study")


def test_a_study_in_one_file_is_a_command(group: command.StudyGroup, tmp_path: Path) -> None:
    (product,) = group.commands.values()
    assert product.help == "Multiply seeds.\n\nThe product of two whole numbers is whole."
    assert product.epilog == "Example:\n\ndvf-ig study product --factor 3 -o study"
    out = tmp_path / "out"
    words = ["--factor", "3", "--sign", "minus", "--powers", "2,3", "--label", "a", "--label", "b"]
    with pytest.raises(SystemExit, match="0"):
        group.main(["product", *words, "--voxel-mm", "1,2,3", "-o", str(out), "--workers", "1"], "study")
    assert sorted(path.name for path in out.iterdir() if not path.name.startswith(".")) == [
        "study.json",
        "summary.json",
        "trials.jsonl",
    ]
    text = (out / "summary.json").read_text()
    for field in ('"products": [\n  3,\n  6', '"sign": "minus"', '"labels": [\n  "a",\n  "b"'):
        assert field in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "Missing option '--factor'"),
        (["--factor", "10"], "less than or equal to 9"),
        (["--factor", "2", "--powers", "1,x"], "needed whole numbers such as 1,2"),
        (["--factor", "2", "--trials", "3"], "--trials is now called --seeds"),
    ],
)
def test_bad_options_are_usage_errors(
    group: command.StudyGroup, tmp_path: Path, words: list[str], said: str, capsys: Any
) -> None:
    with pytest.raises(SystemExit, match="2"):
        group.main(["product", *words, "-o", str(tmp_path / "out")], "study")
    assert said in " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


def test_what_a_study_refuses_is_bad_input(tmp_path: Path) -> None:
    words = ["study", "gating", "--records", str(tmp_path), "-o", str(tmp_path / "out")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 3
    assert "has no annotated record at all" in done.stderr
    assert not (tmp_path / "out").exists()


def test_threads_are_limited_before_numba_is_loaded(tmp_path: Path) -> None:
    words = ["study", "cines", "--data", str(tmp_path), "--threads", "1", "-o", str(tmp_path / "out")]
    code = (
        "from typer.testing import CliRunner; from dvf_ig.cli.main import app; "
        f"assert CliRunner().invoke(app, {words}).exit_code == 3; "
        "import numba; assert numba.config.NUMBA_NUM_THREADS == 1"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
