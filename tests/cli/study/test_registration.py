"""`dvf-ig study same-image|capture|gating-error|planes|failures` on a stubbed registration problem."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from stub_registration import stub_problem
from typer.testing import CliRunner, Result

import dvf_ig.study.registration.page as capture_page
import dvf_ig.study.registration.trial as trials
from dvf_ig.cli.main import app
from dvf_ig.io import write_text
from dvf_ig.io.writing.listing import LISTING
from dvf_ig.study.registration.experiments import MOTIONS

COMMANDS = {"same-image": "A", "capture": "B", "gating-error": "D", "planes": "E", "failures": "F"}
FILES = ("study.json", "trials.jsonl", "summary.json", "report.html")
PAGE = capture_page.write_capture_page


@pytest.fixture(autouse=True)
def stubbed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    def page(lines: list[dict[str, Any]], path: Path) -> None:
        write_text(path, f"{len(lines)} registrations")

    trials._problem.cache_clear()
    monkeypatch.setattr(trials, "make_problem", stub_problem)
    monkeypatch.setattr(capture_page, "write_capture_page", page)
    yield
    trials._problem.cache_clear()


def invoke(command: str, out: Path, *options: str) -> Result:
    arguments = ["study", command, "-o", str(out), "--workers", "1", *options]
    return CliRunner().invoke(app, arguments)


def lines_of(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "trials.jsonl").read_text().splitlines()]


def test_help_names_the_commands() -> None:
    shown = CliRunner().invoke(app, ["study", "--help"], env={"COLUMNS": "120"})
    assert shown.exit_code == 0
    assert all(f" {name} " in shown.stdout for name in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_study_writes_its_four_files(command: str, tmp_path: Path) -> None:
    out = tmp_path / "study"
    done = invoke(command, out, "--seeds", "1", "--seed", "5", "--json")
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in out.iterdir()) == sorted([*FILES, LISTING])
    summary = json.loads(done.stdout)
    assert summary == json.loads((out / "summary.json").read_text())
    assert (summary["arm"], summary["pairs"], summary["seed"]) == (COMMANDS[command], 1, 5)
    lines = lines_of(out)
    assert {line["pair"] for line in lines} == {5}
    assert sum(group["n"] for group in summary["groups"]) == len(lines)
    near = sum(line["start_mm"] <= 12.0 for line in lines)
    assert sum(group["n"] for group in summary["starts_up_to_12_mm"]) == near
    assert json.loads((out / "study.json").read_text())["settings"]["arm"] == COMMANDS[command]
    assert f"{len(lines)} registrations" in (out / "report.html").read_text()


def test_the_page_is_that_of_the_trials(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_page, "write_capture_page", PAGE)
    assert invoke("same-image", tmp_path, "--seeds", "1").exit_code == 0
    page = (tmp_path / "report.html").read_text()
    assert "6 registrations" in page
    assert all(motion in page for motion in MOTIONS)


def test_options_of_capture_are_those_of_the_trials(tmp_path: Path) -> None:
    chosen = ("--quality", "poor-image", "--quality", "no-mismatch", "--per-bin", "2", "--to", "4")
    done = invoke("capture", tmp_path, "--seeds", "2", *chosen)
    assert done.exit_code == 0, done.output
    lines = lines_of(tmp_path)
    assert {line["quality"] for line in lines} == {"poor-image", "no-mismatch"}
    assert len(lines) == 2 * 2 * 2 * 4, "pairs, qualities, motions, starts"
    assert max(line["start_mm"] for line in lines) <= 4.0
    assert "TRE median" in done.output
    assert all(name in done.output.replace("\n", "") for name in FILES)


def test_a_study_goes_on_and_its_folder_is_of_one_study(tmp_path: Path) -> None:
    assert invoke("same-image", tmp_path, "--seeds", "1").exit_code == 0
    first = lines_of(tmp_path)
    assert invoke("same-image", tmp_path, "--seeds", "2").exit_code == 0
    assert lines_of(tmp_path)[: len(first)] == first
    assert len(lines_of(tmp_path)) == 2 * len(first)
    other = invoke("failures", tmp_path, "--seeds", "1")
    assert other.exit_code == 3
    assert "another study" in other.output
    assert len(lines_of(tmp_path)) == 2 * len(first)


def test_refused_trials_are_counted_and_said(tmp_path: Path) -> None:
    done = invoke("same-image", tmp_path, "--seeds", "2", "--seed", "12")
    assert done.exit_code == 0, done.output
    assert "6 of 12 trials were refused; the first: pair 13 is refused" in done.output.replace("\n", " ")
    assert (
        sum(group["refused"] for group in json.loads((tmp_path / "summary.json").read_text())["groups"]) == 6
    )


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("capture", ("--quality", "excellent")),
        ("capture", ("--to", "1")),
        ("capture", ("--per-bin", "0")),
        ("same-image", ("--seeds", "0")),
        ("planes", ("--per-bin", "2")),
        ("failures", ("--workers", "0")),
        ("gating-error", ("--seed", "one")),
    ],
)
def test_a_bad_option_ends_with_2_and_no_trial(
    command: str, options: tuple[str, ...], tmp_path: Path
) -> None:
    done = invoke(command, tmp_path / "study", *options)
    assert done.exit_code == 2, done.output
    assert not (tmp_path / "study" / "summary.json").exists()
    lines = tmp_path / "study" / "trials.jsonl"
    assert not lines.exists() or not lines.read_text()


@pytest.mark.parametrize("former", ["--pairs", "--pairs=1", "--trials"])
def test_a_former_option_says_the_new_one(former: str, tmp_path: Path) -> None:
    done = invoke("same-image", tmp_path, former, "1")
    assert done.exit_code == 2
    assert f"{former.partition('=')[0]} is now called --seeds" in done.output.replace("\n", " ")
