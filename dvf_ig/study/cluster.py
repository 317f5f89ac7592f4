"""Groups of trials on the workers of a dask.distributed scheduler (extra `cluster`).

`dask scheduler` on one machine, and `NUMBA_NUM_THREADS=1 dask worker tcp://HOST:8786 --nthreads 1
--nworkers -1` on each that works, all with this version of dvf_ig. Workers may come and go: the groups of a
lost worker are done again by another.
"""

import hashlib
import json
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import dvf_ig
from dvf_ig.core.errors import DvfIgError, InvalidInputError, MissingDependencyError, install_extra

Lines = list[dict[str, Any]]

ANSWER_S = 20.0
"""How long the scheduler may take to answer."""

FIRST_WORKER_S = 60.0
"""How long a scheduler may be without any worker when a study begins."""

RETRIES = 1
"""A group that raised is tried once more: a worker may lack memory or a file share for a moment."""


def cluster_results(
    task: Callable[[Sequence[int]], Lines],
    groups: Sequence[Sequence[int]],
    address: str,
    *,
    identity: Any,
    first_worker_s: float = FIRST_WORKER_S,
) -> Iterator[Lines]:
    """Lines of each group as it is done.

    Args:
        task: seeds to lines; a module-level function or a partial of one, importable on the workers.
        groups: seeds, a task each.
        address: of the scheduler, "tcp://HOST:PORT".
        identity: JSON value that tells this study from any other; with the seeds it names a task, so that
            a study begun again while its first run still works does not do a group twice.
        first_worker_s: how long to wait for the first worker.
    Raises:
        MissingDependencyError: the extra is absent here, or dvf_ig on a worker.
        InvalidInputError: no scheduler or no worker answers, or a worker has another version of dvf_ig.
        DvfIgError: the scheduler was lost, or a group ended every worker that tried it.
    """
    distributed = _package()
    if not groups:
        return
    with _quiet_client_log(), _client(distributed, address) as client:
        _wait_for_worker(distributed, client, address, first_worker_s)
        waiting = [
            client.submit(
                _on_worker,
                task,
                list(group),
                dvf_ig.__version__,
                key=_key(identity, group),
                pure=False,
                retries=RETRIES,
            )
            for group in groups
        ]
        for future in distributed.as_completed(waiting, loop=client.loop):
            yield _result(distributed, future, address)


def _on_worker(task: Callable[[Sequence[int]], Lines], group: Sequence[int], version: str) -> Lines:
    if dvf_ig.__version__ != version:
        raise InvalidInputError(
            f"a worker of the cluster has dvf_ig {dvf_ig.__version__}, this machine {version}; install the "
            "same version on both"
        )
    return task(group)


def _key(identity: Any, group: Sequence[int]) -> str:
    content = json.dumps([dvf_ig.__version__, identity, list(group)], sort_keys=True)
    return f"trials-{hashlib.sha256(content.encode()).hexdigest()[:16]}-from-seed-{group[0]}"


def _result(distributed: ModuleType, future: Any, address: str) -> Lines:
    again = "the trials done before are kept, run the study again to go on"
    try:
        lines: Lines = future.result()
    except distributed.CancelledError as exc:
        raise DvfIgError(f"the dask scheduler at {address} was lost; {again}") from exc
    except distributed.KilledWorker as exc:
        raise DvfIgError(
            f"{exc.allowed_failures + 1} workers ended while they did {exc.task} (out of memory?); give the "
            f"workers more memory; {again}"
        ) from exc
    except ImportError as exc:
        raise MissingDependencyError(
            f"a worker of the cluster cannot load the trial ({exc}); install dvf_ig there, then {again}"
        ) from exc
    return lines


def _package() -> ModuleType:
    try:
        import distributed
    except ImportError as exc:
        raise MissingDependencyError(
            f"trials on a cluster need dask.distributed; {install_extra('cluster')}"
        ) from exc
    module: ModuleType = distributed
    return module


def _client(distributed: ModuleType, address: str) -> Any:
    try:
        return distributed.Client(address, timeout=ANSWER_S, set_as_default=False)
    except (OSError, ValueError) as exc:
        raise InvalidInputError(
            f"no dask scheduler answers at {address}; start one with `dask scheduler` and give the address "
            'it prints, "tcp://HOST:8786"'
        ) from exc


@contextmanager
def _quiet_client_log() -> Iterator[None]:
    """Silence tracebacks of a lost connection, which is reported here as one sentence."""
    log = logging.getLogger("distributed.client")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)


def _wait_for_worker(distributed: ModuleType, client: Any, address: str, timeout_s: float) -> None:
    try:
        client.wait_for_workers(1, timeout=timeout_s)
    except distributed.TimeoutError as exc:
        raise InvalidInputError(
            f"the dask scheduler at {address} has no worker after {timeout_s:.0f} s; start some with "
            f"`dask worker {address} --nthreads 1`"
        ) from exc
