"""A replay that gave no force says why and how to mend it; recordings that disagree are told on its page."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.guidance import Status
from dvf_ig.intake.findings import Disagreement, finding
from dvf_ig.replay import Replay, result_of
from dvf_ig.session.reasons import NoForce, no_force


def with_status(replay: Replay, *codes: Status) -> Replay:
    """The replay with the first status until there was a pose, and equal shares of the others after it."""
    ticks = replay.ticks
    status = np.full(len(ticks), int(codes[0]))
    later = np.flatnonzero(ticks.status != Status.NO_POSE)
    for part, code in zip(np.array_split(later, len(codes) - 1), codes[1:], strict=True):
        status[part] = code
    return replace(replay, ticks=replace(ticks, status=status))


def test_a_force_needs_no_excuse(replay: Replay) -> None:
    assert result_of(replay)["no_force"] is None
    assert result_of(replay)["warnings"] == []


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.OK])
def test_every_status_is_told_with_what_to_do(replay: Replay, status: Status) -> None:
    told = result_of(with_status(replay, Status.NO_POSE, status))["no_force"]
    cause = NoForce.UNSURE_SHAPE if status is Status.UNSEEN else NoForce[status.name]
    assert told is not None
    assert told.startswith(cause.value.split("{", maxsplit=1)[0])
    assert any(what in told for what in (": check ", ": give ", ": image "))


def test_a_heart_that_slices_show_in_part_has_parts_that_they_do_not_show() -> None:
    told = no_force({Status.UNSEEN: 3}, posed=True, reason=None, whole=False)
    assert told is not None
    assert told.startswith("the tool was at a part of the heart that no MR slice shows in 100% of the ticks")


def test_what_kept_the_force_back_is_looked_for_after_the_first_pose(replay: Replay) -> None:
    mixed = (Status.OUT_OF_VOLUME, Status.OUT_OF_VOLUME, Status.NO_PHASE)
    told = result_of(with_status(replay, Status.NO_POSE, *mixed))["no_force"]
    assert told is not None
    assert told.startswith("the tool stayed outside the box of the model in 67% of the ticks")


@pytest.mark.usefixtures("blank_pictures")
def test_the_command_tells_and_ends_with_7(
    replay: Replay, written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    doubt = finding(Disagreement.TOOL_FAR_FROM_HEART, "tool", "replay", mm=77.0)
    done = replace(with_status(replay, Status.NO_POSE, Status.OUT_OF_VOLUME), findings=(doubt,))
    monkeypatch.setattr("dvf_ig.replay.run_replay", lambda *_, **__: done)
    run = CliRunner().invoke(app, ["replay", str(written), "-o", str(tmp_path / "run")])
    assert run.exit_code == 7, run.output
    assert "error: no force was given: the tool stayed outside the box of the model in 100%" in run.stderr
    assert f"note: tool: {doubt.sentence}" in run.stderr
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert result["no_force"].startswith("the tool stayed outside")
    assert [warning["cause"] for warning in result["warnings"]] == ["TOOL_FAR_FROM_HEART"]
    page = (tmp_path / "run" / "report.html").read_text()
    assert "No force was given: the tool stayed outside the box of the model" in page
    assert "comes no nearer to the heart than 77 mm" in page
