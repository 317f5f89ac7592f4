"""A recording of the Rerun viewer read back by its own reader: a pixel at its place in the MR."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy_ball import ball_model
from toy_run import BRIGHT, FIRST, FORCE, LAG_S, LATER, PROBE_FROM_IMAGE, pose_at, run_folder, ticks_csv

from dvf_ig.core import MissingDependencyError, OutputError
from dvf_ig.replay.export.rerun_file import FORCE_MM_PER_N, write_rerun
from dvf_ig.replay.run_folder import read_ticks


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[float, dict[str, Any]]]]:
    """Of each entity, (seconds, components) of every row."""
    reader = pytest.importorskip("rerun.chunk", reason="rerun-sdk (0.7 GB) is not installed")
    folder = tmp_path_factory.mktemp("rerun")
    (folder / "ticks.csv").write_text(ticks_csv())
    assert write_rerun(run_folder(), ball_model(), read_ticks(folder / "ticks.csv"), folder / "run.rrd") == 7
    found: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    for chunk in reader.RrdReader(str(folder / "run.rrd")).stream():
        for row in chunk.to_record_batch().to_pylist():
            stamp = row.get("time")
            at = -1.0 if stamp is None else stamp.total_seconds()
            found.setdefault(str(chunk.entity_path), []).append((at, row))
    return {entity: sorted(held, key=lambda one: one[0]) for entity, held in found.items()}


def test_a_full_disk_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def __init__(self, *_: Any, **__: Any) -> None:
            pass

        def save(self, path: str) -> None:
            raise RuntimeError("Failed to encode LogMsg: No space left on device (os error 28)")

    package = SimpleNamespace(RecordingStream=Full)
    monkeypatch.setattr("dvf_ig.replay.export.rerun_file._package", lambda: package)
    (tmp_path / "ticks.csv").write_text(ticks_csv())
    with pytest.raises(OutputError, match=r"run\.rrd: Failed to encode LogMsg: No space left"):
        write_rerun(run_folder(), ball_model(), read_ticks(tmp_path / "ticks.csv"), tmp_path / "run.rrd")
    assert not (tmp_path / "run.rrd").exists()


def matrix(row: dict[str, Any]) -> np.ndarray:
    """To the parent; Rerun stores a matrix column by column."""
    out = np.eye(4)
    out[:3, :3] = np.array(row["Transform3D:mat3x3"][0]).reshape(3, 3).T
    out[:3, 3] = row["Transform3D:translation"][0]
    return out


def test_the_bright_pixel_lies_at_its_place_in_the_mr(
    rows: dict[str, list[tuple[float, dict[str, Any]]]],
) -> None:
    tracker, probe = rows["/mr/tracker"], rows["/mr/tracker/probe"]
    assert [at for at, _ in tracker] == pytest.approx([LAG_S, 0.5])
    assert len(probe) == 7
    in_probe = PROBE_FROM_IMAGE.apply_pixels(np.array([BRIGHT], dtype=float)).xyz_mm[0]
    for item, pose in ((0, FIRST), (4, LATER)):
        at, row = probe[item]
        turn, shift = pose_at(at)
        expected = pose.rotation @ (turn @ in_probe + shift) + pose.translation_mm
        held = [one for when, one in tracker if when <= at][-1]
        place = (matrix(held) @ matrix(row) @ [*in_probe, 1.0])[:3]
        np.testing.assert_allclose(place, expected, atol=1e-3)  # 32-bit floats


def test_force_surfaces_and_curves(rows: dict[str, list[tuple[float, dict[str, Any]]]]) -> None:
    ((at, arrow),) = rows["/mr/tracker/force"]
    assert at == pytest.approx(0.101)
    np.testing.assert_allclose(arrow["Arrows3D:vectors"][0], FORCE_MM_PER_N * FORCE)
    assert len(rows["/mr/heart"]) == 4
    curve = rows["/numbers/force_n"]
    assert [row["Scalars:scalars"][0] for _, row in curve] == pytest.approx([0.0, np.linalg.norm(FORCE)])
    assert [row["TextLog:text"][0] for _, row in rows["/supervisor"]] == ["fade: no_pose", "ok"]
    assert [row["TextLog:text"][0] for _, row in rows["/breathing"]] == ["locked"]
    assert [row["Scalars:scalars"][0] for _, row in rows["/numbers/breath_mm"]] == [4.0]
    assert len(rows["/ultrasound"]) == 7


def test_it_says_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rerun", None)
    with pytest.raises(MissingDependencyError, match=r"pip install '\.\[rerun\]'"):
        write_rerun(run_folder(), ball_model(), {}, tmp_path / "run.rrd")
