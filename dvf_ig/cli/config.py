"""`dvf-ig config`: begin, show and check the file that describes a lab's own recordings."""

import inspect
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Argument, Option
from typer.core import TyperCommand

from .shell import JsonFlag, command, emit, out_file, set_options, warn, wrote

if TYPE_CHECKING:
    from dvf_ig.intake.draft import Verdict
    from dvf_ig.intake.problems import Problem, Use
    from dvf_ig.intake.schema import Form

app = typer.Typer(
    no_args_is_help=True,
    help="A lab's own recordings as one file, session.yaml, for register, replay and serve: begin, show, "
    "check it.",
)

USES: "tuple[Use, Use]" = ("register", "replay")
SessionArgument = Annotated[Path, Argument(metavar="SESSION", help="A session.yaml, or a scenario folder.")]
OutputOption = Annotated[Path, out_file("session.yaml to write.")]


class InitCommand(TyperCommand):
    """A command with an option for every key that has one, from the table that is read when it is used."""

    @cached_property
    def _from_table(self) -> Any:
        one = typer.Typer(add_completion=False)
        one.command()(_init_function())
        return typer.main.get_command(one)

    @property
    def params(self) -> Any:
        return self._from_table.params

    @params.setter
    def params(self, given: Any) -> None:
        """The table has them."""

    @property
    def callback(self) -> Any:
        return self._from_table.callback

    @callback.setter
    def callback(self, given: Any) -> None:
        """The one with the table's options."""


def init() -> None:
    """Begin a session.yaml from a lab's files: look into each, say what is missing or does not fit.

    Exits 0 when `register` could run with it. Where something is still missing, the file is written
    with commented lines for it; where a file cannot be read or does not fit, nothing is written.
    """


def _init_function() -> Any:
    """`init` with its options."""
    from dvf_ig.intake.schema import KEYS

    def begin(output: Path, as_json: bool, **given: Any) -> None:
        with command():
            _begin({name: given[_variable(name)] for name in named}, output, as_json=as_json)

    named = [name for name, key in KEYS.items() if key.option]
    options: dict[str, tuple[Any, Any]] = {
        "output": (OutputOption, inspect.Parameter.empty),
        "as_json": (JsonFlag, False),
    }
    for name in named:
        key = KEYS[name]
        note = f"{key.note[:1].upper()}{key.note[1:]}."
        option = Option(*key.options, metavar=key.metavar, help=note)
        options[_variable(name)] = (Annotated[_kind_of(key.form), option], None)
    set_options(begin, options)
    return begin


def _variable(name: str) -> str:
    return name.replace(".", "_")


def _kind_of(form: "Form") -> Any:
    from dvf_ig.intake.schema import Form

    kinds: dict[Form, Any] = {
        Form.NUMBER: float | None,
        Form.PAIR: tuple[str, str] | None,
        Form.VOLUMES: list[str] | None,
    }
    return kinds.get(form, str | None)


def _begin(given: Mapping[str, Any], output: Path, *, as_json: bool) -> None:
    from dvf_ig.intake.draft import begin_session
    from dvf_ig.intake.parts import descriptions
    from dvf_ig.intake.schema import option_names
    from dvf_ig.intake.write import session_text
    from dvf_ig.io import write_text

    if not given["ultrasound.file"] and not given["ultrasound.volumes"]:
        raise typer.BadParameter("give --us SWEEP, or --us-volume FILE@PHASE")
    config, verdict = begin_session(given, output)
    verdict = _tried(verdict)
    described, options = descriptions(verdict.files), option_names()
    wrong = [p for p in (*verdict.unreadable, *verdict.misfits) if p.concerns("register")]
    if not wrong:
        write_text(output, session_text(config, described))
    emit(_payload(output, verdict, described), _rows(output, verdict, described, ways=True), as_json=as_json)
    if wrong:
        _refuse([f"{p.key}: {p.error.sentence(options)}" for p in wrong])
    wrote(output)
    heart = verdict.files.preop
    if heart is not None and heart.of_anybody:
        warn("nothing shows whose heart the model is; give its cine (--mr), or say whose it is (--patient)")
    for problem in verdict.misfits:
        warn(f"a replay cannot use {problem.key}: {problem.error.sentence(options)}")
    _warn_of(verdict)
    lacking = [problem.key for problem in verdict.missing if problem.concerns("register")]
    if lacking:
        _refuse([f"{output} is written, but register cannot run yet; it lacks: {', '.join(lacking)}"])


def dump(session: SessionArgument, as_json: JsonFlag = False) -> None:
    """Print the complete configuration with every default, as YAML; saved next to the files it reads back."""
    with command():
        from dvf_ig.intake.session import open_session
        from dvf_ig.intake.write import dump_text

        config, _ = open_session(session)
        if as_json:
            emit(config.model_dump(mode="json", by_alias=True), (), as_json=True)
        else:
            sys.stdout.write(dump_text(config))


def validate(
    session: SessionArgument,
    purpose: Annotated[
        Literal["register", "replay"] | None,
        Option("--for", help="What it is to be used for (default: all that it names, for register)."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Open every file of a configuration and check that all fit; name each that does not, and what to do.

    Exits 0 when all is well, else 3 after one line for each problem.
    """
    with command():
        from dvf_ig.intake.draft import judge_session
        from dvf_ig.intake.parts import descriptions
        from dvf_ig.intake.session import open_session

        config, folder = open_session(session)
        verdict = judge_session(config, folder, str(session))
        described = descriptions(verdict.files)
        if not _wrong(verdict, purpose) and verdict.files.recorded_calibrations:
            verdict = _calibrated(verdict)
        if not _wrong(verdict, purpose):
            verdict = _tried(verdict)
        emit(_payload(session, verdict, described), _rows(session, verdict, described), as_json=as_json)
        wrong = _wrong(verdict, purpose)
        _warn_of(verdict)
        if wrong:
            _refuse([problem.sentence for problem in wrong])


def schema(
    output: Annotated[Path | None, out_file("File to write instead of stdout.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Write the JSON schema of a session.yaml, with which an editor completes keys and marks mistakes.

    `config init` begins a session.yaml with the line by which an editor finds session.schema.json next to it.
    """
    with command(lists_inputs=False):
        from dvf_ig.intake.write import session_schema
        from dvf_ig.io import write_json

        described = session_schema()
        if output is not None:
            write_json(output, described)
            wrote(output)
        if output is None or as_json:
            emit(described, (), as_json=True)


app.command("init", cls=InitCommand)(init)
app.command("schema")(schema)
app.command("dump")(dump)
app.command("validate")(validate)


def _wrong(verdict: "Verdict", purpose: "Use | None") -> "list[Problem]":
    """Problems that prevent a purpose; without one, everything that does not fit."""
    wrong = list(verdict.hindrances(purpose or "register"))
    if purpose is None:
        wrong += [problem for problem in verdict.misfits if problem not in wrong]
    return wrong


def _calibrated(verdict: "Verdict") -> "Verdict":
    """The verdict with what a replay would say of calibrations that are still recordings."""
    from dvf_ig.intake.calibrations import calibrate
    from dvf_ig.intake.fit import fit_of
    from dvf_ig.intake.problems import ProblemList

    problems, files = ProblemList(), verdict.files
    with problems.about("calibration"):
        calibrations = calibrate(files.calibrations, seed=0)
        image, lag_s = calibrations.ultrasound.probe_from_image, calibrations.ultrasound.lag_s
        fit = fit_of(files.with_calibrations(image, lag_s, calibrations.tip))
        return replace(verdict, misfits=fit.misfits, warnings=fit.warnings, seen=fit.seen)
    return replace(verdict, misfits=(*verdict.misfits, *problems.items))


def _tried(verdict: "Verdict") -> "Verdict":
    """The verdict after all that `register` does before it searches the pose, if a file holds the model."""
    from dvf_ig.intake.problems import ProblemList
    from dvf_ig.replay.registration import prepare_registration

    files = verdict.files
    if verdict.hindrances("register") or files.sweep is None or files.model is None:
        return verdict
    problems = ProblemList()
    with problems.about("ultrasound"):
        prepare_registration(files.scenario, model=files.model)
    return replace(verdict, misfits=(*verdict.misfits, *problems.items))


def _warn_of(verdict: "Verdict") -> None:
    for doubt in verdict.warnings:
        warn(f"{doubt.key}: {doubt.sentence}")


def _readiness(use: "Use", verdict: "Verdict") -> str:
    keys = list(dict.fromkeys(problem.key for problem in verdict.hindrances(use)))
    return "can run" if not keys else f"cannot run yet: {', '.join(keys)}"


def _refuse(sentences: Sequence[str]) -> None:
    """Print one line for each problem, and end with the exit code of bad input."""
    for sentence in sentences:
        typer.secho(f"error: {sentence}", err=True, fg=typer.colors.RED)
    raise typer.Exit(3)


def _payload(path: Path, verdict: "Verdict", described: Mapping[str, str | None]) -> dict[str, Any]:
    kinds = {"unreadable": verdict.unreadable, "misfit": verdict.misfits, "missing": verdict.missing}
    return {
        "session": str(path),
        "parts": dict(described),
        "ready": {use: not verdict.hindrances(use) for use in USES},
        "problems": [
            {"key": p.key, "kind": kind, "hinders": p.hinders, "sentence": str(p.error)}
            for kind, problems in kinds.items()
            for p in problems
        ],
        "ecg_delay": None if verdict.seen is None else verdict.seen.values(),
        "warnings": [{"key": w.key, "cause": w.cause.name, "sentence": w.sentence} for w in verdict.warnings],
    }


def _rows(
    path: Path, verdict: "Verdict", described: Mapping[str, str | None], *, ways: bool = False
) -> list[tuple[str, ...]]:
    """Rows of parts, of what can be done and of what is missing; with `ways` the options that give it."""
    from dvf_ig.intake.parts import PARTS

    wrong = [p.key for p in (*verdict.unreadable, *verdict.misfits)]
    rows = [("session", str(path))]
    for part in PARTS:
        spoilt = any(key == part.key or key.startswith(f"{part.key}.") for key in wrong)
        rows.append((part.label, described[part.key] or ("cannot be used" if spoilt else "-")))
    if verdict.seen is not None:
        rows.append(("ECG and images", verdict.seen.sentence))
    rows += [(use, _readiness(use, verdict)) for use in USES]
    rows += [("missing", f"{p.error.message} ({_ways(p.key) if ways else p.key})") for p in verdict.missing]
    return [*rows]


def _ways(part: str) -> str:
    """The options that give a part: its key's, or those of its section that need no other."""
    from dvf_ig.intake.schema import KEYS

    listed = [
        f"{key.options[0]} {key.metavar}"
        for name, key in KEYS.items()
        if key.option and not key.goes_with and (name == part or name.startswith(f"{part}."))
    ]
    return ", or ".join(listed)
