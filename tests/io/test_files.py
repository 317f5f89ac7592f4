"""Atomic writing, JSON, descriptions, `dvf-ig inspect`, and what importing costs."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import dvf_ig.io
from dvf_ig.cli.inspect.command import inspect
from dvf_ig.core import DvfIgError, OutputError, PoseStream, UnreadableFileError
from dvf_ig.intake import describe, write_scenario
from dvf_ig.io import output_folder, read_json, write_json
from dvf_ig.io.writing.atomic import atomic_file

app = typer.Typer()
app.command()(inspect)


class Colour(Enum):
    RED = "red"


@dataclass(frozen=True)
class Value:
    array: np.ndarray
    colour: Colour


def test_json_of_results(tmp_path: Path) -> None:
    value = {
        "n": np.int64(3),
        "x": np.float64(0.1),
        "bad": [np.nan, np.inf],
        "v": Value(np.eye(2), Colour.RED),
        "p": Path("a"),
    }
    write_json(tmp_path / "r.json", value)
    expected = {
        "n": 3,
        "x": 0.1,
        "bad": [None, None],
        "v": {"array": [[1.0, 0.0], [0.0, 1.0]], "colour": "red"},
        "p": "a",
    }
    assert read_json(tmp_path / "r.json") == expected == json.loads((tmp_path / "r.json").read_text())
    with pytest.raises(OutputError, match="cannot write a set"):
        write_json(tmp_path / "r.json", {1, 2})
    assert read_json(tmp_path / "r.json") == expected


def test_nothing_half_written(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def fail() -> None:
        with atomic_file(target) as temporary:
            temporary.write_text("half")
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError):
        fail()
    assert target.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_unwritable(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with (
        pytest.raises(OutputError, match="cannot make the folder"),
        output_folder(tmp_path / "file" / "below"),
    ):
        pass
    with pytest.raises(OutputError, match="cannot write"):
        write_json(tmp_path / "file" / "a.json", {})


def test_output_folder_leaves_nothing_when_the_work_fails(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="failed"), output_folder(tmp_path / "a" / "b"):
        raise RuntimeError("failed")
    assert not list(tmp_path.iterdir())
    with output_folder(tmp_path / "a" / "b") as folder:
        (folder / "kept").write_text("x")
    assert (tmp_path / "a" / "b" / "kept").exists()


def test_exports_are_importable_and_documented() -> None:
    public = [name for name in vars(dvf_ig.io) if name.startswith(("read_", "write_", "describe", "output_"))]
    assert len(public) >= 40
    assert all(getattr(dvf_ig.io, name).__doc__ for name in public if callable(getattr(dvf_ig.io, name)))


def test_importing_io_is_light() -> None:
    heavy = "{'numba', 'SimpleITK', 'open3d', 'cv2', 'matplotlib', 'wfdb', 'pandas'}"
    code = f"import sys, dvf_ig.io, dvf_ig.cli.inspect.command; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


KINDS = [
    ("bivme-cine", "surfaces", {"patient_id": "patient1", "phases": 25, "closed": False}),
    ("bivme-cine/sax_4d.nii.gz", "image", {"size": [256, 208, 6], "phases": 25, "type": "int16"}),
    ("heartdeform-wh/wh_template.vtp", "mesh", {"closed": True, "open_edges": 0}),
    ("lsqrrecipes/pivotCalibrationData.txt", "tool poses", {"samples": 481}),
    ("mitdb-ds1/101.hea", "ECG", {"rate_hz": 360.0, "leads": ["MLII", "V1"]}),
    (
        "plus-fcal20-nwire/PlusDeviceSet_fCal_Sim_SpatialCalibration_2.0.xml",
        "PLUS",
        {"nwire_patterns": 3, "landmarks": 8},
    ),
    (
        "plus-temporal-watertank/WaterTankBottomTranslationCombined.igs.mha",
        "tracked sequence",
        {"frames": 201, "image_size_px": [820, 616], "orientation": "MFA", "gaps": 0},
    ),
]


@pytest.mark.parametrize(("name", "kind", "facts"), KINDS, ids=[name for name, _, _ in KINDS])
def test_inspect_real_files(data_dir: Path, name: str, kind: str, facts: dict[str, Any]) -> None:
    done = CliRunner().invoke(app, [str(data_dir / name), "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert kind in result["kind"]
    assert {key: result[key] for key in facts} == facts


def test_inspect_prints_a_table(data_dir: Path) -> None:
    done = CliRunner().invoke(app, [str(data_dir / "plus-temporal-watertank" / KINDS[-1][0].split("/")[1])])
    assert done.exit_code == 0
    lines = {" ".join(line.split()) for line in done.stdout.splitlines()}
    assert "images 820 x 616 px, orientation MFA, all valid" in lines
    assert any(line.startswith("├─ probe tracker_from_probe: all valid, moves 7.4 x 7.0") for line in lines)


def test_inspect_scenario(tmp_path: Path, make_scenario: Callable[..., Any]) -> None:
    write_scenario(make_scenario(1), tmp_path / "s")
    result = json.loads(CliRunner().invoke(app, [str(tmp_path / "s"), "--json"]).stdout)
    assert result["kind"] == "scenario folder"
    assert result["patient_id"] == "heart-7"
    assert result["truth"] is True
    labels = describe(str(tmp_path / "s" / "preop" / "labels.nrrd")).facts
    assert (labels["labels"], labels["phases"], labels["type"]) == ([0, 1, 2, 3], 3, "uint8")
    for name in ("start.tfm", "landmarks_mr.mrk.json", "tool.igs.mha", "preop/mr.nrrd", "ecg.csv"):
        assert CliRunner().invoke(app, [str(tmp_path / "s" / name)]).exit_code == 0


def test_inspect_bad_input(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("?")
    for name in ("a.xyz", "none.mha"):
        done = CliRunner().invoke(app, [str(tmp_path / name)])
        assert done.exit_code == 3
        assert done.stdout == ""
    with pytest.raises(UnreadableFileError, match="of no kind that can be read"):
        describe(str(tmp_path / "a.xyz"))
    with pytest.raises(DvfIgError):
        describe(str(tmp_path))


def test_frozen_poses_are_counted(tmp_path: Path) -> None:
    n = 20
    shift = np.random.default_rng(0).normal(size=(n, 3))
    shift[5:11] = shift[5]
    shift[15:18] = shift[15]
    rotations = np.tile(np.eye(3), (n, 1, 1))
    stream = PoseStream("tracker", "tool", np.arange(n) / 50, rotations, shift, np.ones(n, bool))
    dvf_ig.io.write_poses(stream, tmp_path / "a.igs.mha")
    facts = describe(str(tmp_path / "a.igs.mha")).facts
    assert facts["transforms"]["tracker_from_tool"]["frozen_share"] == 6 / 20
    assert facts["rate_hz"] == pytest.approx(50)
