"""Shared parts of all studies: trials over processes or a cluster, resuming, and what is written.

A study is one file of this folder (or `study.py` in a folder of its own) that ends in `STUDY`. Its
docstring says in the first line what the study does, then what it claims and on what, and ends with example
commands; the command line finds it by that and makes its options from the settings. Seeds and hearts that a
study is tuned on are named before they are used; the unit of a claim is the heart or the recording.

The folder of a study with trials holds `study.json` (its settings) and `trials.jsonl` (one JSON line a
trial). A study that was stopped goes on: running it again with the same settings does only what is missing.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

from dvf_ig.core.errors import DvfIgError, InvalidInputError, OutputError, UnreadableFileError
from dvf_ig.io import files_together, output_folder, plain, read_json, write_json, write_text
from dvf_ig.io.writing.atomic import write_bytes
from dvf_ig.io.writing.place import alone_in, file_place

Settings = dict[str, Any]
Line = dict[str, Any]
Seeds = Sequence[int]
"""A group of trials that one process works through, one after the other."""

Rows = list[tuple[str, ...]]
"""A table to print."""

Work = Callable[[Settings, int], Line]
"""One trial: settings and seed to its line. A module-level function, so that processes can load it."""

Progress = Callable[[float], None]
"""Called with the fraction done."""


@dataclass(frozen=True, slots=True)
class Result:
    """Result of a study.

    Attributes:
        fields: JSON values for `--json`; several mappings are printed one a line.
        table: for people.
        files: name to content; a mapping is written as JSON.
        notes: warnings for the user.
        remarks: sentences that belong to the result, such as assumptions.
    """

    fields: Mapping[str, Any] | Sequence[Mapping[str, Any]]
    table: Rows
    files: Mapping[str, Mapping[str, Any] | str | bytes] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Study:
    """A study as the command line needs it.

    Attributes:
        settings: frozen dataclass of fields made by `options.option`.
        run: (settings, driver) to the result.
        outputs: settings to the names of the files it may write.
        trials: it has trials, and with them workers and a scheduler.
        needs_folder: `--out` must be given.
        threads: it takes `--threads`.
        lists_inputs: its JSON names the files that were read.
    """

    settings: type[Any]
    run: "Callable[[Any, Driver], Result]"
    outputs: Callable[[Any], tuple[str, ...]] = lambda _: ("summary.json",)
    trials: bool = True
    needs_folder: bool = True
    threads: bool = False
    lists_inputs: bool = False


@dataclass(frozen=True, slots=True)
class Driver:
    """Runner of a study's trials that shows its progress.

    Attributes:
        progress: title to a context that gives a `Progress`.
        folder: where the study writes; None if it only prints.
        workers, scheduler: see `run_trials`.
        threads: for a study that computes in this process.
    """

    progress: Callable[[str], AbstractContextManager[Progress]]
    folder: Path | None = None
    workers: int = 1
    scheduler: str | None = None
    threads: int = 1

    def trials(
        self, trials: "Trials", seeds: Seeds, *, group_size: int = 1, below: str = "", alone: bool = False
    ) -> list[Line]:
        """Lines of all seeds in their order (see `run_trials`).

        Args:
            group_size: see `run_trials`.
            below: subfolder for these trials; empty: the study's own folder.
            alone: one process; for trials that measure time.
        """
        if self.folder is None:
            raise TypeError("trials need a folder")
        with output_folder(self.folder / below), self.progress(trials.name) as report:
            return run_trials(
                trials,
                seeds,
                self.folder / below,
                workers=1 if alone else self.workers,
                group_size=group_size,
                scheduler=None if alone else self.scheduler,
                progress=report,
            )


def run_study(study: Study, settings: Any, driver: Driver) -> Result:
    """Run a study and write its files, all of them or none.

    Raises:
        OutputError: a file must not be replaced, or the folder cannot be written.
    """
    if driver.folder is None:
        return study.run(settings, driver)
    with output_folder(driver.folder, study.outputs(settings)):
        result = study.run(settings, driver)
        with files_together(driver.folder, study.outputs(settings)) as new:
            for name, content in result.files.items():
                if isinstance(content, bytes):
                    write_bytes(new / name, content)
                elif isinstance(content, str):
                    write_text(new / name, content)
                else:
                    write_json(new / name, content)
    return result


def refusals(lines: Sequence[Line]) -> tuple[str, ...]:
    """A note about refused trials, if there are any."""
    bad = [line["refused"] for line in lines if "refused" in line]
    return (f"{len(bad)} of {len(lines)} trials were refused; the first: {bad[0]}",) if bad else ()


_THREAD_LIMITS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Trials:
    """Work of each trial.

    Attributes:
        name: of the work.
        settings: JSON values that every trial gets; a folder holds trials of one set of them.
        work: see Work. A DvfIgError it raises becomes the trial's line {"seed", "refused"}.
    """

    name: str
    settings: Settings
    work: Work


def run_trials(
    trials: Trials,
    seeds: Seeds,
    folder: Path,
    *,
    workers: int = 1,
    group_size: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Line]:
    """Return the lines of all seeds in their order; those already in the folder are not computed again.

    Lines are written as soon as their group is done, each with workers=1.

    Args:
        trials: what to do.
        seeds: one a trial, none twice.
        folder: exists; gets study.json and trials.jsonl.
        workers: processes; 1 works in this one. Not used with a scheduler.
        group_size: consecutive seeds that one process works through, for trials that share costly
            preparation; what is done already is left out of a group.
        scheduler: address of a dask.distributed scheduler ("tcp://HOST:8786") whose workers do the groups.
        progress: called with the fraction of the trials that is done.
    Raises:
        InvalidInputError: a seed twice, no worker, an empty group, a folder that holds trials of another
            study, or no scheduler at the address.
        MissingDependencyError: a scheduler is given and the extra `cluster` is absent.
        DvfIgError: a worker process or the scheduler was lost; finished lines are kept.
        OutputError: the folder cannot be written.
    """
    if len(set(seeds)) < len(seeds) or workers < 1 or group_size < 1:
        raise InvalidInputError(
            f"{len(seeds)} trials with {len(set(seeds))} different seeds, in groups of {group_size} on "
            f"{workers} workers; needed different seeds, and at least 1 worker and 1 trial in a group"
        )
    path = file_place(folder / "trials.jsonl")
    _bind_folder(trials, folder)
    with alone_in(folder):
        stored, length = _kept_lines(path)
        _continue_at(path, length)
    finished = {line["seed"]: line for line in stored}
    whole = [seeds[first : first + group_size] for first in range(0, len(seeds), group_size)]
    remaining = [[seed for seed in group if seed not in finished] for group in whole]
    groups = [group for group in remaining if group]
    missing = sum(map(len, groups))
    progress(1 - missing / max(1, len(seeds)))
    for lines in _results(trials, groups, workers, scheduler):
        _append(path, lines)
        finished |= {line["seed"]: line for line in lines}
        missing -= len(lines)
        progress(1 - missing / len(seeds))
    return [finished[seed] for seed in seeds]


def _continue_at(path: Path, whole: int) -> None:
    """Remove a line that a kill cut short; a file that cannot be written is found before the work."""
    try:
        with path.open("ab") as stream:
            stream.truncate(whole)
    except OSError as exc:
        raise OutputError(f"cannot continue {path}: {exc.strerror or exc}") from exc


def _append(path: Path, lines: Sequence[Line]) -> None:
    rows = [json.dumps(line, allow_nan=False, ensure_ascii=False) + "\n" for line in lines]
    try:
        with alone_in(path.parent), path.open("ab") as stream:
            stream.write("".join(rows).encode())
    except OSError as exc:
        raise OutputError(f"cannot write {path}: {exc.strerror or exc}") from exc


def _results(
    trials: Trials, groups: Sequence[Seeds], workers: int, scheduler: str | None
) -> Iterator[list[Line]]:
    """Lines as they are done."""
    if scheduler is None:
        return _local_results(trials, groups, workers)
    from .cluster import cluster_results

    identity = [trials.name, trials.settings, trials.work.__module__, trials.work.__qualname__]
    return cluster_results(partial(_group_lines, trials), groups, scheduler, identity=plain(identity))


def _local_results(trials: Trials, groups: Sequence[Seeds], workers: int) -> Iterator[list[Line]]:
    """Lines of each group as it is done, or of each trial where this process does them all."""
    if workers == 1 or len(groups) < 2:
        yield from ([_trial(trials, seed)] for group in groups for seed in group)
        return
    task, context = partial(_group_lines, trials), get_context("spawn")
    with _one_thread_each(), ProcessPoolExecutor(workers, context, _end_with_parent) as pool:
        waiting = [pool.submit(task, group) for group in groups]
        try:
            for future in as_completed(waiting):
                yield future.result()
        except BrokenProcessPool as exc:
            raise DvfIgError(
                "a worker process of the study ended unexpectedly (killed, or out of memory); the trials "
                "done before are kept, run the study again to go on"
            ) from exc
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _end_with_parent() -> None:
    """Workers of a killed study would wait for work for ever."""
    parent = parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def _group_lines(trials: Trials, group: Seeds) -> list[Line]:
    return [_trial(trials, seed) for seed in group]


def _trial(trials: Trials, seed: int) -> Line:
    try:
        row = trials.work(trials.settings, seed)
    except DvfIgError as exc:
        return {"seed": seed, "refused": str(exc)}
    line: Line = plain({"seed": seed, **row})
    return line


def _bind_folder(trials: Trials, folder: Path) -> None:
    """Write study.json, or make sure that the folder's is of this study."""
    path = folder / "study.json"
    expected = plain({"study": trials.name, "settings": trials.settings})
    if not path.exists():
        if (folder / "trials.jsonl").exists():
            raise OutputError(
                f"cannot write {folder / 'trials.jsonl'}: it exists, and no study.json names the study that "
                "wrote it; choose another folder"
            )
        write_json(path, expected)
    elif read_json(path, "a study") != expected:
        raise InvalidInputError(
            f"{folder} holds trials of another study or of other settings (see {path.name}); choose another "
            "folder"
        )


def trials_of(folder: Path) -> list[Line]:
    """Read the trials of a study's folder.

    Raises:
        InvalidInputError: it holds none, or is damaged.
    """
    lines, _ = _kept_lines(folder / "trials.jsonl")
    if not lines:
        raise InvalidInputError(f"{folder} holds no trials of a study; give the folder that a study wrote")
    return lines


def _kept_lines(path: Path) -> tuple[list[Line], int]:
    """Read complete lines and their length in bytes; a line that a kill cut short is left out."""
    if not path.exists():
        return [], 0
    try:
        data = path.read_bytes()
        whole = data.rfind(b"\n") + 1
        return [json.loads(line) for line in data[:whole].splitlines()], whole
    except OSError as exc:
        raise UnreadableFileError(f"cannot read {path}: {exc.strerror or exc}") from exc
    except ValueError as exc:
        raise InvalidInputError(f"{path} is damaged ({exc}); remove it and run the study again") from exc


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started in the block use one thread: the workers already fill the machine."""
    before = {name: os.environ.get(name) for name in _THREAD_LIMITS}
    os.environ.update(dict.fromkeys(_THREAD_LIMITS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
