"""The guide's fifteen lines give the replay's force to the last bit, and its tables name what is there."""

import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from dvf_ig import session
from dvf_ig.replay import Replay, events_of

PAGE = (Path(__file__).resolve().parents[2] / "dvf_ig/docs/guide/own-program.md").read_text(encoding="utf-8")
FIFTEEN, LIVE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.usefixtures("known_registrations")
def test_fifteen_lines_give_the_replay_s_force(
    written: Path, replay: Replay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "DIR").symlink_to(written)
    monkeypatch.chdir(tmp_path)
    printed: list[tuple[float, np.ndarray[Any, Any]]] = []
    exec(FIFTEEN, {"print": lambda *values: printed.append(values)})
    ticks = replay.ticks
    times, forces = (np.array(column)[: len(ticks)] for column in zip(*printed, strict=True))
    np.testing.assert_array_equal(times, ticks.t_s)
    np.testing.assert_array_equal(forces, ticks.force_n)
    assert np.count_nonzero(np.linalg.norm(forces, axis=1) > 0.1) > 1000


def test_they_are_fifteen_and_name_nothing_private() -> None:
    lines = [line for line in FIFTEEN.splitlines() if line.strip()]
    assert len(lines) <= 15
    assert not re.search(r"\b_\w", FIFTEEN + LIVE)


def test_the_live_loop_runs(replay: Replay) -> None:
    events = events_of(replay.scenario)
    upcoming = [next(events)]
    clock = [0.0]

    def ticks() -> Iterator[float]:
        for tick in range(300):
            clock[0] = tick / 1000
            yield clock[0]

    def arrived() -> Iterator[session.Event]:
        while upcoming[0][0] <= clock[0]:
            yield upcoming[0][1]
            upcoming[0] = next(events)

    sent: list[Any] = []
    names = {"setup": replay.setup, "clock": ticks, "arrived": arrived, "send": sent.append}
    exec(LIVE, {"session": session, **names})
    assert len(sent) == 300
    assert not np.any(sent), "no registration is there after 0.3 s"


def test_every_event_stands_in_the_table_with_its_fields() -> None:
    rows = dict(re.findall(r"^\| `([A-Z]\w+)` \| ((?:`\w+`(?:, )?)+) \|", PAGE, re.MULTILINE))
    expected = {
        event.__name__: ", ".join(f"`{field.name}`" for field in fields(event))
        for event in get_args(session.Event)
    }
    assert rows == expected


def test_what_the_table_of_the_state_names_is_there() -> None:
    table = PAGE.split("| of `GuidanceState` |")[1].split("\n\n")[0]
    firsts = re.findall(r"^\| (`.+?`) \|", table, re.MULTILINE)
    named = set(re.findall(r"`(\w+)`", " ".join(firsts)))
    assert len(named) >= 15
    assert not {name for name in named if not hasattr(session.GuidanceState, name)}
