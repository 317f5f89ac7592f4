"""Trials on a real dask.distributed cluster of this machine: the same lines, also when a worker is killed."""

import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from multiples import deadly, mistaken, multiple, whereabouts
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import DvfIgError, InvalidInputError, MissingDependencyError
from dvf_ig.study.cluster import cluster_results
from dvf_ig.study.driver import Line, Trials, run_trials

distributed = pytest.importorskip("distributed", reason="the extra `cluster` (dask.distributed) is absent")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two processes; a trial that ends two of them is not tried again."""
    from dask import config

    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    with (
        config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(**options) as cluster,
    ):
        yield cluster


def lines_on_disk(folder: Path) -> list[Line]:
    return [json.loads(line) for line in (folder / "trials.jsonl").read_text().splitlines()]


def test_the_lines_are_those_of_this_machine(cluster: Any, tmp_path: Path) -> None:
    study = Trials("multiples", {"factor": 3}, multiple)
    local, remote = tmp_path / "local", tmp_path / "remote"
    local.mkdir()
    remote.mkdir()
    run_trials(study, [3], remote)
    shares: list[float] = []
    lines = run_trials(
        study, range(1, 9), remote, group_size=4, scheduler=cluster.scheduler_address, progress=shares.append
    )
    assert lines == run_trials(study, range(1, 9), local)
    assert lines[4] == {"seed": 5, "refused": "seed 5 is refused"}
    assert shares[0] == pytest.approx(1 / 8)
    assert len(shares) == 3
    assert sorted(line["seed"] for line in lines_on_disk(remote)) == list(range(1, 9))


def test_a_worker_killed_in_the_middle_loses_nothing(cluster: Any, tmp_path: Path) -> None:
    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        workers = set(client.run(os.getpid).values())
    killed: list[int] = []

    def kill_in_the_middle(share: float) -> None:
        if share >= 0.25 and not killed:
            # who has just handed in a group is at work on its next one
            killed.append(lines_on_disk(tmp_path)[-1]["process"])
            os.kill(killed[0], signal.SIGKILL)

    study = Trials("whereabouts", {"seconds": 0.05}, whereabouts)
    address = cluster.scheduler_address
    lines = run_trials(
        study, range(48), tmp_path, group_size=3, scheduler=address, progress=kill_in_the_middle
    )
    assert [line["seed"] for line in lines] == list(range(48))
    assert sorted(line["seed"] for line in lines_on_disk(tmp_path)) == list(range(48))
    groups = [{line["process"] for line in lines[first : first + 3]} for first in range(0, 48, 3)]
    assert all(len(processes) == 1 for processes in groups)
    assert killed[0] in workers
    assert 0 < sum(processes == set(killed) for processes in groups) < 12


def test_a_trial_that_ends_its_workers_and_a_mistake_are_told(cluster: Any, tmp_path: Path) -> None:
    address = cluster.scheduler_address
    for name in ("deadly", "mistaken"):
        (tmp_path / name).mkdir()
    with pytest.raises(ZeroDivisionError, match="seed 1"):
        run_trials(Trials("mistaken", {}, mistaken), [1], tmp_path / "mistaken", scheduler=address)
    study = Trials("deadly", {"deadly": 2}, deadly)
    with pytest.raises(DvfIgError, match=r"2 workers ended .*from-seed-2 .*run the study again"):
        run_trials(study, [1, 2], tmp_path / "deadly", scheduler=address)


def test_a_lost_scheduler_is_told_and_what_was_done_is_kept(tmp_path: Path) -> None:
    study = Trials("whereabouts", {"seconds": 0.02}, whereabouts)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as cluster:

        def stop(share: float) -> None:
            if share >= 0.1:
                cluster.close()

        with pytest.raises(DvfIgError, match="was lost; the trials done before are kept"):
            run_trials(study, range(40), tmp_path, scheduler=cluster.scheduler_address, progress=stop)
    assert len(lines_on_disk(tmp_path)) >= 4


def test_no_scheduler_no_worker_and_no_package_are_sentences(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = Trials("multiples", {"factor": 3}, multiple)
    with pytest.raises(InvalidInputError, match="no dask scheduler answers at nowhere"):
        run_trials(study, [1], tmp_path, scheduler="nowhere://1")
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as empty,
        pytest.raises(InvalidInputError, match="has no worker after 0 s"),
    ):
        list(cluster_results(lambda _: [], [[1]], empty.scheduler_address, identity=1, first_worker_s=0.1))
    arguments = [
        "study",
        "calibration",
        "--kind",
        "wall",
        "--scheduler",
        "nowhere://1",
        "-o",
        str(tmp_path / "cli"),
    ]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 3
    assert "no dask scheduler answers at nowhere://1" in done.output
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"pip install '\.\[cluster\]'"):
        run_trials(study, [1], tmp_path, scheduler="tcp://127.0.0.1:1")
