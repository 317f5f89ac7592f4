"""Parts that all commands share: options, exit codes, where output goes.

Results go to stdout (a table, or one JSON value with --json); messages, progress and the list of written
files go to stderr.
"""

import errno
import inspect
import json
import logging
import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option
from typer.core import TyperGroup

if TYPE_CHECKING:
    from dvf_ig.core.errors import DvfIgError

UNEXPECTED = 70
"""Exit code of a fault of this program (EX_SOFTWARE)."""

JsonFlag = Annotated[bool, Option("--json", help="Print the result as JSON on stdout.")]
SeedOption = Annotated[int, Option("--seed", help="Seed of every random choice.")]
ThreadsOption = Annotated[int | None, Option("--threads", min=1, help="Threads to use (default: all cores).")]
EcgRateOption = Annotated[
    float | None,
    Option("--rate", help="Sampling rate (Hz) of an ECG that states none.", min=1.0, max=100_000.0),
]
EcgLeadOption = Annotated[
    str | None,
    Option("--lead", help="Leads of the ECG to use, separated by commas (default: all named as one)."),
]
ProbeNameOption = Annotated[
    str | None, Option("--probe-name", help="The probe's sensor, as the recording names it (default: Probe).")
]
ReferenceNameOption = Annotated[
    str | None,
    Option(
        "--reference-name",
        help="What its poses are relative to (default: Reference where it is recorded, else Tracker).",
    ),
]
VoxelOption = Annotated[
    str | None,
    Option(
        "--voxel-mm",
        help="Voxel size where the header has lost it, three numbers of mm, for example 1.5,1.5,10.",
    ),
]


def output_file(path: Path | None) -> Path | None:
    """Check an option that names a file to write (typer callback)."""
    if path is not None:
        with _stated_errors():
            from dvf_ig.io import require_outputs
            from dvf_ig.io.provenance import recorded_inputs

            with recorded_inputs():
                require_outputs(path)
    return path


def output_dir(path: Path | None) -> Path | None:
    """Check an option that names a folder to write into (typer callback)."""
    if path is not None:
        with _stated_errors():
            from dvf_ig.io import require_folder

            require_folder(path)
    return path


def out_file(help: str) -> Any:
    """Make the option -o of a command that writes a file."""
    return Option("-o", "--out", callback=output_file, help=help)


def out_folder(help: str) -> Any:
    """Make the option -o of a command that writes a folder."""
    return Option("-o", "--out", callback=output_dir, help=help)


def set_options(function: Callable[..., None], options: Mapping[str, tuple[Any, Any]]) -> None:
    """Make annotation and default of each option, by name, those that typer reads of a function."""
    kind = inspect.Parameter.KEYWORD_ONLY
    function.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, kind, default=of[1], annotation=of[0]) for name, of in options.items()]
    )
    function.__annotations__ = {name: annotation for name, (annotation, _) in options.items()}


def exit_code(error: "DvfIgError") -> int:
    """Exit code of an error: 2 usage, 3 bad input, 4 cannot write, 5 no overlap, 6 not converged, 7 gate."""
    from dvf_ig.core import errors

    codes: tuple[tuple[type[DvfIgError], int], ...] = (
        (errors.MissingDependencyError, 2),
        (errors.InvalidInputError, 3),
        (errors.OutputError, 4),
        (errors.NoOverlapError, 5),
        (errors.NotConvergedError, 6),
        (errors.QualityGateError, 7),
    )
    return next((code for kind, code in codes if isinstance(error, kind)), 3)


_provenance: ContextVar[Callable[[], Mapping[str, Any]]] = ContextVar("provenance", default=dict)
"""Fields that `emit` adds to a result."""
_json_due: ContextVar[bool] = ContextVar("json_due", default=False)
"""Whether --json was given, and stdout holds no JSON yet."""


@contextmanager
def command(threads: int | None = None, *, lists_inputs: bool = True) -> Iterator[None]:
    """Body of a command: limits threads, records what is read, prints each logged warning as a note,
    and turns a DvfIgError into one sentence and its exit code.

    Args:
        threads: see `limit_threads`.
        lists_inputs: its result says which files were read, and versions; not where other processes read.
    """
    if threads is not None:
        limit_threads(threads)
    from dvf_ig.io.provenance import recorded_inputs

    listed = _inputs_listed() if lists_inputs else nullcontext()
    with _stated_errors(), _notes_of_warnings(), recorded_inputs(), listed:
        yield


@contextmanager
def _stated_errors() -> Iterator[None]:
    """Turn an error of this program into one sentence and its exit code."""
    from dvf_ig.core.errors import DvfIgError  # not before: it brings scipy, and threads are limited first

    try:
        yield
    except DvfIgError as error:
        kind = type(error).__name__.removesuffix("Error")
        state_error(_sentence(error), exit_code(error), kind=kind, key=error.key, path=error.path)
        raise typer.Exit(exit_code(error)) from error
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        name = str(error.filename)
        state_error(f"a file cannot have the name '{name[:60]}…', which is too long", 3)
        raise typer.Exit(3) from error


def state_error(
    sentence: str, code: int, *, kind: str = "InvalidInput", key: str | None = None, path: Path | None = None
) -> None:
    """Print an error on stderr; with --json also as a JSON object on stdout, unless a result is there.

    Args:
        code: exit code of the program.
        kind: class of the error.
        key: key of a session.yaml that it concerns; path: file or folder.
    """
    typer.secho(f"error: {_one_line(sentence)}", err=True, fg=typer.colors.RED)
    _emit_error(sentence, code, kind, key, path)


def _emit_error(
    sentence: str, code: int, kind: str, key: str | None = None, path: Path | None = None
) -> None:
    if _json_due.get():
        where = {"key": key, "path": None if path is None else str(path)}
        _write_json({"error": {"kind": kind, "exit_code": code, "message": sentence, **where}})


USAGE_ERROR: Any = typer.BadParameter.__bases__[0]
"""Mistake in options; typer has had click's class, and since 0.26 one of its own."""


class Program(TyperGroup):
    """The whole program, which knows whether JSON is due on stdout when it fails."""

    def main(self, args: Sequence[str] | None = None, *rest: Any, **more: Any) -> Any:
        words = sys.argv[1:] if args is None else args
        _json_due.set("--json" in words)
        return super().main(args, *rest, **more)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; a mistake in its options is also printed as JSON."""
        try:
            return super().invoke(ctx)
        except USAGE_ERROR as error:
            _emit_error(error.format_message(), 2, "Usage")
            raise


def _sentence(error: "DvfIgError") -> str:
    """The sentence of an error: by keys if a key of a session.yaml is concerned, else by options."""
    if error.key is not None:
        return f"{error.key}: {error}"
    if not error.settings:
        return error.message
    from dvf_ig.intake.schema import option_names

    return error.sentence(option_names())


def report_unexpected(error: Exception) -> int:
    """Write the traceback of an exception that nothing foresaw to a file, and say so in one sentence.

    Returns:
        the exit code.
    """
    at = traceback.extract_tb(error.__traceback__)[-1]
    what = f"{type(error).__name__} at {Path(at.filename).name}:{at.lineno}"
    lines = [f"{' '.join(sys.argv)}\n", *traceback.format_exception(error)]
    try:
        handle, name = tempfile.mkstemp(prefix="dvf-ig-error-", suffix=".log")
        with open(handle, "w", encoding="utf-8", errors="backslashreplace") as stream:
            stream.writelines(lines)
        where = f"details in {name}, which belongs to a report of this fault"
    except OSError as exc:
        where = f"its details could not be written ({exc.strerror})"
    text = f"the program failed in a way that it did not foresee ({what}); {where}"
    state_error(text, UNEXPECTED, kind="Unexpected")
    return UNEXPECTED


def _one_line(text: str) -> str:
    """A message whose names of files may hold anything, without line breaks and controls of a terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


@contextmanager
def _inputs_listed() -> Iterator[None]:
    from dvf_ig.io.provenance import provenance_fields

    token = _provenance.set(provenance_fields)
    try:
        yield
    finally:
        _provenance.reset(token)


class _Notes(logging.Handler):
    """Tells each warning that is logged as a note, once."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._told: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        message = record.getMessage()
        if message not in self._told:
            self._told.add(message)
            warn(message)


@contextmanager
def _notes_of_warnings() -> Iterator[None]:
    logger, handler = logging.getLogger("dvf_ig"), _Notes()
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def limit_threads(threads: int) -> None:
    """Use at most `threads` threads; must run before numba is loaded."""
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = str(threads)


def cores_or(asked: int | None) -> int:
    """Threads or processes to use: what was asked for, or one for each core."""
    return asked or os.cpu_count() or 1


def whole_numbers(text: str, option: str, example: str) -> tuple[int, ...]:
    """The numbers of a list such as 1,2,5.

    Raises:
        typer.BadParameter: something else.
    """
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError as exc:
        raise typer.BadParameter(f"{option} is '{text}'; needed whole numbers such as {example}") from exc


def voxel_size(text: str | None) -> tuple[float, float, float] | None:
    """Parse X,Y,Z of --voxel-mm.

    Raises:
        typer.BadParameter: another form.
    """
    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"--voxel-mm is '{text}'; needed three numbers, e.g. 1.5,1.5,10") from None
    return x, y, z


def emit(result: Mapping[str, Any], rows: Sequence[tuple[str, ...]], *, as_json: bool) -> None:
    """Print a result: one JSON object, with where it comes from, or its rows as aligned columns."""
    if as_json:
        _write_json({**result, **_provenance.get()()})
        return
    columns = max((len(row) for row in rows), default=0)
    widths = [max(len(row[c]) for row in rows if len(row) > c) for c in range(columns)]
    for row in rows:
        print("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=False)).rstrip())


def _write_json(value: Mapping[str, Any]) -> None:
    json.dump(value, sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")
    _json_due.set(False)


def wrote(path: Path, frame: str | None = None) -> None:
    """Tell the user about a file and the frame of what is in it."""
    note = f"  (frame {frame})" if frame else ""
    typer.echo(_one_line(f"wrote {path}{note}"), err=True)


def warn(message: str) -> None:
    """One sentence that the user should know although the command goes on."""
    typer.secho(f"note: {_one_line(message)}", err=True, fg=typer.colors.YELLOW)


@contextmanager
def progress(title: str) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on stderr if it is a terminal; yields `report(fraction done)`.

    The time left is estimated from the first report on, by the time since the start.
    """
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskProgressColumn, TextColumn
    from rich.text import Text

    class TimeLeft(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(time_left(task.elapsed or 0.0, task.completed))

    columns = (TextColumn(f"{title:<28}"), BarColumn(), TaskProgressColumn(), TimeLeft())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)


def time_left(elapsed_s: float, fraction: float) -> str:
    """Describe how long a task will still take, if it goes on as fast as until now."""
    if fraction <= 0.0:
        return f"{elapsed_s:.0f} s"
    left_s = elapsed_s * (1.0 - fraction) / fraction
    return f"{left_s:.0f} s left" if left_s < 120.0 else f"{left_s / 60.0:.0f} min left"
