"""The documentation and the code name each other rightly: paths exist, commands and their options exist."""

import ast
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer.main
from toy_touched import beating_model

from dvf_ig.cli.main import app
from dvf_ig.io import write_model

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "dvf_ig" / "docs").rglob("*.md")])
CODE = sorted(
    path
    for folder in ("dvf_ig", "data_synth", "tests", "scripts")
    for path in (ROOT / folder).rglob("*")
    if path.is_file() and path.suffix in ("", ".py") and path != Path(__file__).resolve()
)
_PATH = re.compile(r"(?<![\w/])(?:dvf_ig|data_synth|scripts|tests)/[\w/.\-]*\w")
_DOCS = re.compile(r"\bdocs/((?:theory|decisions|guide)/[\w\-]+)")
_OUTSIDE = re.compile(
    r"\b(?:PEERS|VOCABULARY\.md|STYLE\.md|DESIGN\.md)\b|\(theory[:,]|dvf_ig/notes|\bnotes?/\d{4}"
)
_LINK = re.compile(r"\]\(([^)#\s]*)(?:#[^)\s]*)?\)")


def test_every_page_is_found() -> None:
    assert len(PAGES) > 25


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_paths_and_links_of_a_page_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    links = {link for link in _LINK.findall(text) if link and "://" not in link}
    missing = {path for path in set(_PATH.findall(text)) if not (ROOT / path).exists()}
    missing |= {link for link in links if not (page.parent / link).exists()}
    assert not missing


def test_the_changelog_links_to_pages_of_the_site_alone() -> None:
    """The site holds the pages of `dvf_ig/docs` and a copy of the changelog beside them."""
    links = _LINK.findall((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    assert links
    assert all(link.startswith("dvf_ig/docs/") or "://" in link for link in links)


def test_texts_that_the_code_cites_are_in_the_repository() -> None:
    missing, outside = [], []
    for path in CODE:
        text = path.read_text(encoding="utf-8")
        name = path.relative_to(ROOT)
        # a decision may be cited by its number alone
        cited = (page for page in _DOCS.findall(text) if not any((ROOT / "dvf_ig/docs").glob(f"{page}*.md")))
        missing += [f"{name}: {page}" for page in cited]
        outside += [f"{name}: {found}" for found in _OUTSIDE.findall(text)]
    assert not missing
    assert not outside


def commands_in(text: str) -> set[str]:
    """`dvf-ig …` in code, without comments, alternatives in brackets, and what the shell does with it."""
    code = re.findall(r"```(?:\w*)\n(.*?)```", text, re.DOTALL) + re.findall(r"`([^`\n]+)`", text)
    lines = (line for block in code for line in block.replace("\\\n", " ").splitlines())
    return {line.split("#")[0].strip() for line in lines if line.strip().startswith("dvf-ig ")}


ALL_COMMANDS = sorted(set().union(*(commands_in(page.read_text(encoding="utf-8")) for page in PAGES)))


@pytest.mark.parametrize("line", ALL_COMMANDS)
def test_a_documented_command_exists_with_its_options(line: str) -> None:
    words = [word for word in shlex.split(line.replace("…", ""))[1:] if word not in ("[", "]")]
    commands = [typer.main.get_command(app)]
    while words and hasattr(commands[0], "commands") and not words[0].startswith("-"):
        first, *words = words
        names = [name for name in first.split("|") if name]
        assert set(names) <= set(commands[0].commands), f"{first} is no command"
        commands = [commands[0].commands[name] for name in names]
    for command in commands:
        known = {name for option in command.params for name in option.opts + option.secondary_opts}
        asked = {word.strip("[],.").split("=")[0] for word in words if word.strip("[],.").startswith("-")}
        assert asked <= known | {"--help"}, f"unknown options in: {line}"


def test_pages_ship_with_the_package() -> None:
    """The wheel takes whole packages; a page outside of them would be left behind."""
    assert (ROOT / "dvf_ig" / "docs" / "find-it.md").is_file()
    assert not (ROOT / "dvf_ig" / "notes").exists()


def test_equations_are_three_steps_from_the_readme() -> None:
    """README → find-it → module → the name that is looked for."""
    assert "dvf_ig/docs/find-it.md" in (ROOT / "README.md").read_text(encoding="utf-8")
    rows = (ROOT / "dvf_ig" / "docs" / "find-it.md").read_text(encoding="utf-8")
    for path in re.findall(r"`((?:dvf_ig|data_synth)/[\w/]+\.py)`", rows):
        assert ast.get_docstring(ast.parse((ROOT / path).read_text(encoding="utf-8"))), path
    for path, name in re.findall(r"`((?:dvf_ig|data_synth)/[\w/]+\.py)` \(`(\w+)`\)", rows):
        tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
        assert name in {getattr(node, "name", "") for node in tree.body}, f"{path} has no {name}"
    for sought in (
        "eq. 3",
        "eqs 7–9",
        "eqs 10–11",
        "T_d",
        "LC2",
        "N-wire solve",
        "pose-and-phase",
        "TRE",
        "R peak",
    ):
        assert f"| [{sought}" in rows, sought


def test_the_python_of_the_readme_gives_a_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    write_model(beating_model(), tmp_path / "heart.npz")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(code, "README.md", "exec"), names)
    assert names["samples"].force_n.any()
