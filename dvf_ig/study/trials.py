"""Many seeded trials of one piece of work, over processes, one JSON line each; a killed study goes on.

A study is a folder: `study.json` says what is studied, `trials.jsonl` holds the trials done so far. Running
it again with the same settings does only what is missing.
"""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

from dvf_ig.core.errors import DvfIgError, InvalidInputError, OutputError
from dvf_ig.io import plain, read_json, write_json

Settings = dict[str, Any]
Line = dict[str, Any]
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
    seeds: Sequence[int],
    folder: Path,
    *,
    workers: int = 1,
    report: Callable[[float], None] = lambda _: None,
) -> list[Line]:
    """The lines of all seeds, in their order; those already in the folder are not worked out again.

    Args:
        study: what to do.
        seeds: one a trial, none twice.
        folder: exists; gets study.json and trials.jsonl.
        workers: processes; 1 works in this one.
        report: told the share of the trials that is done.
    Raises:
        InvalidInputError: a seed twice, no worker, or a folder that holds trials of another study.
        OutputError: the folder cannot be written.
    """
    if len(set(seeds)) < len(seeds) or workers < 1:
        raise InvalidInputError(
            f"{len(seeds)} trials with {len(set(seeds))} different seeds on {workers} workers; needed "
            "different seeds and at least 1 worker"
        )
    _claim(study, folder)
    path = folder / "trials.jsonl"
    done = {line["seed"]: line for line in _kept_lines(path)}
    missing = [seed for seed in seeds if seed not in done]
    report(1 - len(missing) / max(1, len(seeds)))
    try:
        with path.open("ab") as stream:
            for count, line in enumerate(_results(study, missing, workers), start=1):
                stream.write(json.dumps(line, allow_nan=False, ensure_ascii=False).encode() + b"\n")
                stream.flush()
                done[line["seed"]] = line
                report(1 - (len(missing) - count) / len(seeds))
    except OSError as exc:
        raise OutputError(f"cannot write {path}: {exc.strerror or exc}") from exc
    return [done[seed] for seed in seeds]


def _results(study: Study, seeds: Sequence[int], workers: int) -> Iterator[Line]:
    """Lines as they are done."""
    one = partial(_trial, study)
    if workers == 1 or len(seeds) < 2:
        yield from map(one, seeds)
        return
    context = get_context("spawn")
    with _one_thread_each(), ProcessPoolExecutor(workers, context, _end_with_parent) as pool:
        waiting = [pool.submit(one, seed) for seed in seeds]
        try:
            for future in as_completed(waiting):
                yield future.result()
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


def _trial(study: Study, seed: int) -> Line:
    try:
        found = study.work(study.settings, seed)
    except DvfIgError as exc:
        return {"seed": seed, "refused": str(exc)}
    line: Line = plain({"seed": seed, **found})
    return line


def _claim(study: Study, folder: Path) -> None:
    """Write study.json, or make sure that the folder's is of this study."""
    path = folder / "study.json"
    wanted = plain({"study": study.name, "settings": study.settings})
    if not path.exists():
        write_json(path, wanted)
    elif read_json(path, "a study") != wanted:
        raise InvalidInputError(
            f"{folder} holds trials of another study or of other settings (see {path.name}); choose another "
            "folder"
        )


def _kept_lines(path: Path) -> list[Line]:
    """Complete lines so far; a line that a kill cut short is removed from the file."""
    if not path.exists():
        return []
    try:
        data = path.read_bytes()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            os.truncate(path, whole)
        return [json.loads(line) for line in data[:whole].splitlines()]
    except OSError as exc:
        raise OutputError(f"cannot continue {path}: {exc.strerror or exc}") from exc
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
