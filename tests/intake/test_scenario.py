"""A scenario folder gives back what was written, to the last bit, or says what is wrong with it."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import tool_of
from toy_ball import structure

from dvf_ig.core import (
    InvalidInputError,
    OutputError,
    Points,
    Preop,
    Respiration,
    Scenario,
    Signal,
    UnreadableFileError,
    Volume,
)
from dvf_ig.guidance import FixtureOptions, FixtureSet, Sigmoid
from dvf_ig.intake import ScenarioNotes, read_scenario, read_session, write_scenario

Make = Callable[..., Scenario]
Same = Callable[..., None]


@settings(max_examples=8)
@given(seed=st.integers(0, 2**31))
def test_round_trip_is_exact(
    tmp_path_factory: pytest.TempPathFactory, seed: int, make_scenario: Make, assert_same: Same
) -> None:
    scenario = make_scenario(seed)
    folder = tmp_path_factory.mktemp("case") / "scenario"
    write_scenario(scenario, folder)
    assert_same(read_scenario(folder), scenario)


def test_touched_points_come_back_exactly(tmp_path: Path, make_scenario: Make, assert_same: Same) -> None:
    surface_mm = np.random.default_rng(3).normal([700.0, 0.0, -200.0], 40.0, (25, 3))
    scenario = replace(make_scenario(2), touched=Points("tracker", surface_mm))
    write_scenario(scenario, tmp_path / "s", ScenarioNotes())
    assert_same(read_scenario(tmp_path / "s"), scenario)
    assert "touched.csv" in (tmp_path / "s" / "README.md").read_text()


def test_a_restarted_tool_clock_is_in_the_file_and_readers_leave_it_out(
    tmp_path: Path, make_scenario: Make, assert_same: Same
) -> None:
    whole = make_scenario(4)
    late = tool_of(whole)
    later = replace(late, t_s=late.t_s - 0.5)
    write_scenario(replace(whole, tool_after_restart=later), tmp_path / "s", ScenarioNotes())
    text = (tmp_path / "s" / "tool.igs.mha").read_text()
    assert f"DimSize = 0 0 {len(late) + len(later)}\n" in text
    stamps = [float(line.split(" = ")[1]) for line in text.splitlines() if "_Timestamp = " in line]
    assert stamps == [*late.t_s.tolist(), *later.t_s.tolist()]
    assert f"{len(late) + len(later)} poses of the tool" in (tmp_path / "s" / "README.md").read_text()
    assert_same(read_scenario(tmp_path / "s"), whole)


def test_fixtures_and_the_models_of_their_structures_come_back(tmp_path: Path, make_scenario: Make) -> None:
    oesophagus = structure("oesophagus", [30.0, 4.0, 0.0], 5.0, still=True)
    wall = FixtureOptions(Sigmoid(1.5, 0.4, -2.0), name="oesophagus", structure=oesophagus)
    folder = tmp_path / "s"
    write_scenario(make_scenario(1), folder, ScenarioNotes(fixtures=FixtureSet((wall,))))
    fixtures = read_session(folder).fixtures
    assert fixtures is not None
    (back,) = fixtures.fixtures
    assert back.described() == wall.described()
    assert back.structure is not None
    np.testing.assert_array_equal(back.structure.coefficients, oesophagus.coefficients)
    assert "oesophagus" in (folder / "README.md").read_text()


def test_without_optional_parts(tmp_path: Path, make_scenario: Make, assert_same: Same) -> None:
    full = make_scenario(1)
    bare = replace(
        full,
        preop=Preop("heart-7", surfaces=full.preop.surfaces),
        fan=None,
        start=None,
        landmarks_mr=None,
        landmarks_tracker=None,
        seed=None,
        truth=None,
    )
    write_scenario(bare, tmp_path / "s")
    assert_same(read_scenario(tmp_path / "s"), bare)


def test_a_cine_with_labels_of_end_diastole_alone_comes_back(tmp_path: Path, make_scenario: Make) -> None:
    full = make_scenario(2)
    assert full.preop.labels is not None
    labels = Volume(full.preop.labels.grid, full.preop.labels.values[0])
    cine = full.preop.mr
    assert cine is not None
    preop = Preop("heart-7", mr=cine, ed_labels=labels, label_names=((1, "lv_blood"),), organ_labels=(1,))
    write_scenario(replace(full, preop=preop), tmp_path / "s")
    again = read_scenario(tmp_path / "s").preop
    assert again.labels is None
    assert again.ed_labels is not None
    assert np.array_equal(again.ed_labels.values, labels.values)
    assert again.mr is not None
    assert np.array_equal(again.mr.values, cine.values)
    assert (again.lv_label, again.organ_labels) == (1, (1,))
    for wrong in (replace(preop, ed_phase=1), replace(preop, mr=None)):
        with pytest.raises(InvalidInputError, match="first phase"):
            write_scenario(replace(full, preop=wrong), tmp_path / "other")


def test_deleting_the_truth_changes_nothing_else(
    tmp_path: Path, make_scenario: Make, assert_same: Same
) -> None:
    scenario = make_scenario(2)
    write_scenario(scenario, tmp_path)
    shutil.rmtree(tmp_path / "truth")
    assert_same(read_scenario(tmp_path), replace(scenario, truth=None))


def test_truth_stays_closed_when_not_wanted(tmp_path: Path, make_scenario: Make) -> None:
    write_scenario(make_scenario(2), tmp_path)
    (tmp_path / "truth" / "truth.json").write_text("garbage")
    assert read_scenario(tmp_path, truth=False).truth is None


def test_layout(tmp_path: Path, make_scenario: Make) -> None:
    write_scenario(make_scenario(), tmp_path / "s")
    files = {p.relative_to(tmp_path / "s").as_posix() for p in (tmp_path / "s").rglob("*") if p.is_file()}
    assert files == {
        ".written_by_dvf_ig.json",
        *("scenario.yaml", "ecg.csv", "ultrasound.igs.mha", "tool.igs.mha", "start.tfm", "start.json"),
        *("landmarks_mr.mrk.json", "landmarks_tracker.mrk.json"),
        *("preop/mr.nrrd", "preop/labels.nrrd", "preop/timing.json"),
        *(f"preop/EPICARDIAL_{i:03d}.vtp" for i in range(4)),
        *(f"preop/LV_EPICARDIAL_{i:03d}.vtp" for i in range(3)),
        *("calibration/pivot.igs.mha", "calibration/nwire.igs.mha", "calibration/nwire.xml"),
        *("calibration/nwire_points.xml", "calibration/latency_tracker.igs.mha"),
        *("calibration/latency_video.igs.mha", "calibration/latency_lines.xml"),
        *("truth/truth.json", "truth/r_peaks.csv", "truth/tool.npz", "truth/surface.npz"),
        "truth/breathing.npz",
    }
    assert [p.name for p in tmp_path.iterdir()] == ["s"], "a temporary folder stayed behind"


def test_rewriting_replaces_the_whole_folder(tmp_path: Path, make_scenario: Make, assert_same: Same) -> None:
    write_scenario(make_scenario(1), tmp_path / "s")
    bare = replace(make_scenario(3), truth=None)
    write_scenario(bare, tmp_path / "s")
    assert_same(read_scenario(tmp_path / "s"), bare)


@pytest.mark.parametrize("stray", ["notes.txt", "preop/notes.txt"])
def test_a_folder_with_anything_else_in_it_is_not_replaced(
    tmp_path: Path, stray: str, make_scenario: Make
) -> None:
    write_scenario(make_scenario(1), tmp_path / "s")
    (tmp_path / "s" / stray).write_text("mine")
    with pytest.raises(OutputError, match="not empty"):
        write_scenario(make_scenario(1), tmp_path / "s")
    assert (tmp_path / "s" / stray).read_text() == "mine"
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_nothing_stays_behind_when_writing_fails(tmp_path: Path, make_scenario: Make) -> None:
    scenario = make_scenario(1)
    broken = replace(scenario, ecg=replace(scenario.ecg, leads=("a,b", "c")))
    with pytest.raises(InvalidInputError, match="a,b"):
        write_scenario(broken, tmp_path / "s")
    assert list(tmp_path.iterdir()) == []


def test_missing_files_are_named_in_one_sentence(tmp_path: Path, make_scenario: Make) -> None:
    write_scenario(make_scenario(), tmp_path)
    (tmp_path / "tool.igs.mha").unlink()
    (tmp_path / "calibration" / "nwire.xml").unlink()
    with pytest.raises(UnreadableFileError, match=r"lacks tool\.igs\.mha \(.*\), calibration/nwire\.xml"):
        read_scenario(tmp_path)


def test_unknown_keys_are_errors(tmp_path: Path, make_scenario: Make) -> None:
    write_scenario(make_scenario(), tmp_path)
    config = tmp_path / "scenario.yaml"
    config.write_text(config.read_text() + "speed: fast\n")
    with pytest.raises(UnreadableFileError, match="speed"):
        read_scenario(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema: dvf_ig.scenario/9\n", "reads 'dvf_ig.scenario/1'"),
        ("- a\n- b\n", "schema 'None'"),
        ("a: [1,\n", "not YAML"),
        ("schema: dvf_ig.scenario/1\nname: x\n", "preset: it is missing"),
    ],
)
def test_bad_configuration(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "scenario.yaml").write_text(text)
    with pytest.raises(UnreadableFileError, match=message):
        read_scenario(tmp_path)


def test_not_a_scenario_folder(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match=r"no scenario\.yaml"):
        read_scenario(tmp_path)


def test_damaged_truth_is_named(tmp_path: Path, make_scenario: Make) -> None:
    write_scenario(make_scenario(), tmp_path)
    path = tmp_path / "truth" / "tool.npz"
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(UnreadableFileError, match=r"tool\.npz"):
        read_scenario(tmp_path)


def test_floats_keep_their_type(tmp_path: Path, make_scenario: Make, assert_same: Same) -> None:
    scenario = make_scenario()
    assert scenario.preop.mr is not None
    values = scenario.preop.mr.values.astype(np.float32) / 3
    preop = replace(scenario.preop, mr=replace(scenario.preop.mr, values=values))
    write_scenario(replace(scenario, preop=preop), tmp_path / "s")
    assert_same(read_scenario(tmp_path / "s").preop, preop)


def test_the_recorded_breath_reads_back_exactly(tmp_path: Path, make_scenario: Make) -> None:
    values = np.random.default_rng(0).standard_normal((40, 2))
    ventilator = Signal(values, 25.0, 0.0, ("pressure_cmh2o", "flow_l_per_s"), "")
    used = Respiration(ventilator.t_s, values[:, :1], "pressure_cmh2o")
    write_scenario(replace(make_scenario(1), ventilator=ventilator, respiration=used), tmp_path / "s")
    read = read_scenario(tmp_path / "s").respiration
    assert read is not None
    assert read.name == "pressure_cmh2o"
    np.testing.assert_array_equal(read.t_s, used.t_s)
    np.testing.assert_array_equal(read.values, used.values)
