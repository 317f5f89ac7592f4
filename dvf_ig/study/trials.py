"""Many seeded trials of one piece of work, over processes or a cluster, one JSON line each.

A study is a folder: `study.json` says what is studied, `trials.jsonl` holds the trials done so far. A killed
study goes on: running it again with the same settings does only what is missing.
"""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

from dvf_ig.core.errors import DvfIgError, InvalidInputError, OutputError, UnreadableFileError
from dvf_ig.io import plain, read_json, write_json
from dvf_ig.io.writing.place import file_place

Settings = dict[str, Any]
Line = dict[str, Any]
Seeds = Sequence[int]
"""A group of trials that one process works through, one after the other."""

Work = Callable[[Settings, int], Line]
"""One trial: settings and seed to what came out. A top-level function, so that processes can be given it."""

_THREAD_LIMITS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Study:
    """What is done in each trial.

    Attributes:
        name: of the study.
        settings: JSON values that every trial gets; a folder holds trials of one set of them.
        work: see Work. A DvfIgError it raises becomes the trial's line {"seed", "refused"}.
    """

    name: str
    settings: Settings
    work: Work


def run_trials(
    study: Study,
    seeds: Seeds,
    folder: Path,
    *,
    workers: int = 1,
    group_size: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Line]:
    """The lines of all seeds, in their order; those already in the folder are not worked out again.

    Lines are written as soon as their group is done, each with workers=1.

    Args:
        study: what to do.
        seeds: one a trial, none twice.
        folder: exists; gets study.json and trials.jsonl.
        workers: processes; 1 works in this one. Not used with a scheduler.
        group_size: so many consecutive seeds, counted from the first, form a group; for trials that share
            costly preparation, which then stays in the process. What is done already is left out of a group.
        scheduler: address of a dask.distributed scheduler ("tcp://HOST:8786") whose workers do the groups.
        progress: told the share of the trials that is done.
    Raises:
        InvalidInputError: a seed twice, no worker, an empty group, a folder that holds trials of another
            study, or no scheduler at the address.
        MissingDependencyError: a scheduler is given and the extra `cluster` is absent.
        DvfIgError: a worker process or the scheduler was lost; the lines done so far are kept.
        OutputError: the folder cannot be written.
    """
    if len(set(seeds)) < len(seeds) or workers < 1 or group_size < 1:
        raise InvalidInputError(
            f"{len(seeds)} trials with {len(set(seeds))} different seeds, in groups of {group_size} on "
            f"{workers} workers; needed different seeds, and at least 1 worker and 1 trial in a group"
        )
    path = file_place(folder / "trials.jsonl")
    _bind_folder(study, folder)
    kept, length = _kept_lines(path)
    done = {line["seed"]: line for line in kept}
    _continue_at(path, length)
    whole = [seeds[first : first + group_size] for first in range(0, len(seeds), group_size)]
    remaining = [[seed for seed in group if seed not in done] for group in whole]
    groups = [group for group in remaining if group]
    missing = sum(map(len, groups))
    progress(1 - missing / max(1, len(seeds)))
    for lines in _results(study, groups, workers, scheduler):
        _append(path, lines)
        done |= {line["seed"]: line for line in lines}
        missing -= len(lines)
        progress(1 - missing / len(seeds))
    return [done[seed] for seed in seeds]


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
        with path.open("ab") as stream:
            stream.write("".join(rows).encode())
    except OSError as exc:
        raise OutputError(f"cannot write {path}: {exc.strerror or exc}") from exc


def _results(
    study: Study, groups: Sequence[Seeds], workers: int, scheduler: str | None
) -> Iterator[list[Line]]:
    """Lines as they are done."""
    if scheduler is None:
        return _local_results(study, groups, workers)
    from .cluster import cluster_results

    identity = [study.name, study.settings, study.work.__module__, study.work.__qualname__]
    return cluster_results(partial(_trials, study), groups, scheduler, identity=plain(identity))


def _local_results(study: Study, groups: Sequence[Seeds], workers: int) -> Iterator[list[Line]]:
    """Lines of each group as it is done, or of each trial where this process does them all."""
    if workers == 1 or len(groups) < 2:
        yield from ([_trial(study, seed)] for group in groups for seed in group)
        return
    task, context = partial(_trials, study), get_context("spawn")
    with _one_thread_each(), ProcessPoolExecutor(workers, context, _end_with_parent) as pool:
        waiting = [pool.submit(task, group) for group in groups]
        try:
            for future in as_completed(waiting):
                yield future.result()
        except BrokenProcessPool as exc:
            raise DvfIgError(
                "a worker process of the study ended unexpectedly (killed, or out of memory); the trials "
                "done so far are kept, run the study again to go on"
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


def _trials(study: Study, group: Seeds) -> list[Line]:
    return [_trial(study, seed) for seed in group]


def _trial(study: Study, seed: int) -> Line:
    try:
        found = study.work(study.settings, seed)
    except DvfIgError as exc:
        return {"seed": seed, "refused": str(exc)}
    line: Line = plain({"seed": seed, **found})
    return line


def _bind_folder(study: Study, folder: Path) -> None:
    """Write study.json, or make sure that the folder's is of this study."""
    path = folder / "study.json"
    wanted = plain({"study": study.name, "settings": study.settings})
    if not path.exists():
        if (folder / "trials.jsonl").exists():
            raise OutputError(
                f"cannot write {folder / 'trials.jsonl'}: it exists, and no study.json names the study that "
                "wrote it; choose another folder"
            )
        write_json(path, wanted)
    elif read_json(path, "a study") != wanted:
        raise InvalidInputError(
            f"{folder} holds trials of another study or of other settings (see {path.name}); choose another "
            "folder"
        )


def trials_of(folder: Path) -> list[Line]:
    """The trials that a study's folder holds so far.

    Raises:
        InvalidInputError: it holds none, or is damaged.
    """
    lines, _ = _kept_lines(folder / "trials.jsonl")
    if not lines:
        raise InvalidInputError(f"{folder} holds no trials of a study; give the folder that a study wrote")
    return lines


def _kept_lines(path: Path) -> tuple[list[Line], int]:
    """Complete lines so far, and their length in bytes; a line that a kill cut short is left out."""
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
