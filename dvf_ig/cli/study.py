"""`dvf-ig study`: a command for each study of `dvf_ig.study`, made from its docstring and its settings.

Listing studies reads docstrings alone; a study is imported when it is asked for.
"""

import inspect
import json
import re
import sys
from dataclasses import MISSING, Field, fields
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer import Argument, Option
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

import dvf_ig
from dvf_ig.cli import shell

if TYPE_CHECKING:
    from dvf_ig.study.driver import Study

FOLDER = Path(dvf_ig.__file__).parent / "study"
EXAMPLE = re.compile(r"^ {4}(dvf-ig study .+)$", re.MULTILINE)
"""Example of a command in a docstring."""
RENAMED = {"--pairs": "--seeds", "--trials": "--seeds"}
"""Former options, by the name they have now."""


def studies() -> dict[str, Path]:
    """Name and file of every study: of `NAME.py`, or of `NAME/study.py`."""
    files = {path.stem: path for path in FOLDER.glob("*.py")}
    files |= {path.parent.name: path for path in FOLDER.glob("*/study.py")}
    return {
        name: files[name]
        for name in sorted(files)
        if re.search(r"^STUDY = ", files[name].read_text(encoding="utf-8"), re.MULTILINE)
    }


class StudyCommand(TyperCommand):
    """A study in a list: its help is its docstring; its options are made when they are needed."""

    def __init__(self, name: str, file: Path) -> None:
        docstring = file.read_text(encoding="utf-8").split('"""')[1]
        paragraphs = [" ".join(text.split()) for text in EXAMPLE.sub("", docstring).strip().split("\n\n")]
        examples = EXAMPLE.findall(docstring)
        head = "Examples:" if len(examples) > 1 else "Example:"
        self._module = f"dvf_ig.study.{name}" + (".study" if file.name == "study.py" else "")
        super().__init__(name, help="\n\n".join(paragraphs), epilog="\n\n".join((head, *examples)))

    @property
    def params(self) -> list[Any]:
        """Options of the study's settings."""
        return list(self._made.params) if "_module" in vars(self) else []

    @params.setter
    def params(self, _: list[Any]) -> None:
        """Ignore those that a command begins with."""

    @property
    def _made(self) -> Any:
        return _command_of(self._module, str(self.name), str(self.help), str(self.epilog))

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Context of the command with its options."""
        for flag in (arg.partition("=")[0] for arg in args):
            if flag in RENAMED:
                raise typer.BadParameter(f"{flag} is now called {RENAMED[flag]}")
        if threads := re.search(r"--threads[ =]([1-9]\d*)", " ".join(args)):
            # numba comes with the study's module and must find the limit
            shell.limit_threads(int(threads[1]))
        return self._made.make_context(info_name, args, parent, **extra)


class StudyGroup(TyperGroup):
    """All studies."""

    def __init__(self, **about: Any) -> None:
        super().__init__(**about)
        self.commands = {name: StudyCommand(name, file) for name, file in studies().items()}


app = typer.Typer(
    cls=StudyGroup,
    help="Many trials with a known truth.",
    epilog="Each has its own examples: dvf-ig study NAME --help",
    no_args_is_help=True,
)


@cache
def _command_of(module: str, name: str, about: str, epilog: str) -> Any:
    """The command of a study, with an option for each field of its settings."""
    study: Study = import_module(module).STUDY
    hints, chosen = get_type_hints(study.settings), fields(study.settings)
    options = {one.name: _option(one, hints[one.name]) for one in chosen} | _shared(study)

    def run(**values: Any) -> None:
        settings = {one.name: _value(one, hints[one.name], values.pop(one.name)) for one in chosen}
        _run(study, study.settings(**settings), **values)

    shell.set_options(run, options)
    alone = typer.Typer(context_settings={"help_option_names": ["-h", "--help"]}, add_completion=False)
    alone.command(name, help=about, epilog=epilog)(run)
    return get_command(alone)


def _option(one: "Field[Any]", hint: Any) -> tuple[Any, Any]:
    """Annotation and default of a field's option."""
    about = one.metadata
    flag = about["flag"] or f"--{one.name.replace('_', '-')}"
    if _is_numbers(hint):
        return Annotated[str | None, Option(flag, help=about["help"])], _with_commas(one)
    if get_origin(hint) is tuple:
        return Annotated[list[get_args(hint)[0]] | None, Option(flag, help=about["help"])], None  # type: ignore[misc]
    default = inspect.Parameter.empty if one.default is MISSING else one.default
    if about["argument"]:
        return Annotated[hint, Argument(help=about["help"])], default
    bounds = {"min": about["least"], "max": about["most"]}
    return Annotated[hint, Option(flag, help=about["help"], **bounds)], default


def _is_numbers(hint: Any) -> bool:
    """Whether a field is written as numbers with commas between them: whole ones, or a voxel size."""
    parts = get_args(hint)
    return parts == (int, ...) or any(get_args(part) == (float, float, float) for part in parts)


def _with_commas(one: "Field[Any]") -> str | None:
    """Default of a field of numbers, as it is written."""
    return ",".join(map(str, one.default)) if isinstance(one.default, tuple) else None


def _value(one: "Field[Any]", hint: Any, value: Any) -> Any:
    """A field's value from its option's."""
    if get_args(hint) == (int, ...):
        return shell.whole_numbers(value, f"--{one.name}", str(_with_commas(one)))
    if _is_numbers(hint):
        return shell.voxel_size(value)
    return tuple(value or ()) if get_origin(hint) is tuple else value


def _shared(study: "Study") -> dict[str, tuple[Any, Any]]:
    """Options that do not belong to a study's settings."""
    about = (
        "Folder; a study that was stopped goes on where it was." if study.trials else "Folder for results."
    )
    folder = shell.out_folder(about)
    options: dict[str, tuple[Any, Any]] = {
        "out": (Annotated[Path, folder], inspect.Parameter.empty)
        if study.needs_folder
        else (Annotated[Path | None, folder], None)
    }
    if study.trials:
        workers = Option("--workers", min=1, help="Processes (default: one for each core).")
        address = "Work on this dask.distributed scheduler instead (tcp://HOST:8786)."
        options["workers"] = (Annotated[int | None, workers], None)
        options["scheduler"] = (Annotated[str | None, Option("--scheduler", help=address)], None)
    if study.threads:
        options["threads"] = (shell.ThreadsOption, None)
    return {**options, "as_json": (shell.JsonFlag, False)}


def _run(
    study: "Study",
    settings: Any,
    *,
    out: Path | None,
    as_json: bool,
    workers: int | None = None,
    scheduler: str | None = None,
    threads: int | None = None,
) -> None:
    """Run a study, print what it found and name the files it wrote."""
    with shell.command(threads, lists_inputs=study.lists_inputs):
        from dvf_ig.io import plain
        from dvf_ig.study.driver import Driver, run_study

        result = run_study(
            study,
            settings,
            Driver(shell.progress, out, shell.cores_or(workers), scheduler, shell.cores_or(threads)),
        )
        for note in result.notes:
            shell.warn(note)
        if as_json and not isinstance(result.fields, dict):
            for line in result.fields:
                sys.stdout.write(json.dumps(plain(line), allow_nan=False) + "\n")
        else:
            shell.emit(plain(result.fields), result.table, as_json=as_json)
        for remark in result.remarks:
            typer.echo(remark, err=True)
        if out is not None:
            for name in ("study.json", "trials.jsonl", *result.files):
                if name in result.files or (study.trials and (out / name).exists()):
                    shell.wrote(out / name)
