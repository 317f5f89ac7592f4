"""A scenario is described in full by one YAML, and its folder says what is in it."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import dvf_ig
import dvf_ig.cli.synth.first_world as first_world
import dvf_ig.cli.synth.scenario as scenario_command
from data_synth import PRESETS, HeartSpec, ScenarioSpec, describe_faults
from dvf_ig.cli.synth.commands import app
from dvf_ig.cli.synth.spec import SpecFile, read_spec, scenario_spec, spec_text
from dvf_ig.core import (
    CycleTiming,
    Grid,
    InvalidInputError,
    Scenario,
    UnreadableFileError,
    Volume,
    VolumeSeries,
)
from dvf_ig.intake import ScenarioNotes, read_scenario, write_scenario


def from_text(folder: Path, text: str) -> ScenarioSpec:
    path = folder / "spec.yaml"
    path.write_text(text)
    return scenario_spec(read_spec(path))


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_every_preset_reads_back_equal(tmp_path: Path, preset: str) -> None:
    file = SpecFile(preset=preset, seed=9, seconds=31.5, motion="physiological", mismatch_mm=0.5)
    got = from_text(tmp_path, spec_text(file))
    assert got.options == PRESETS[preset]
    assert (got.preset, got.seed, got.seconds, got.motion, got.mismatch) == (
        preset,
        9,
        31.5,
        "physiological",
        0.5,
    )


def test_the_help_and_the_guide_name_every_preset() -> None:
    assert scenario_command.PRESET_NAMES.split(", ") == list(PRESETS)
    rows = (Path(dvf_ig.__file__).parent / "docs" / "guide" / "main-job.md").read_text().splitlines()
    assert [row.split("`")[1] for row in rows if row.startswith("| `")] == list(PRESETS)


def test_few_keys_change_a_preset_and_nothing_else(tmp_path: Path) -> None:
    text = "preset: ectopy\noptions:\n  ecg: {lead_off_s: [[5, 9.5]]}\n  tool_tracker: {latency_s: 0.02}\n"
    options = from_text(tmp_path, text).options
    assert options.ecg.lead_off_s == ((5.0, 9.5),)
    assert options.tool_tracker.latency_s == 0.02
    assert options.tool_tracker.rate_hz == PRESETS["ectopy"].tool_tracker.rate_hz
    assert options.rhythm == PRESETS["ectopy"].rhythm


def test_the_key_of_occlusions_is_sight(tmp_path: Path) -> None:
    options = from_text(tmp_path, "options:\n  sight: {losses_per_min: 2}\n").options
    assert options.occlusion.losses_per_min == 2.0
    assert options.occlusion.loss_s == PRESETS["calm"].occlusion.loss_s
    document = yaml.safe_load(spec_text(SpecFile()))
    assert "sight" in document["options"]
    assert "occlusion" not in document["options"]


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("options: {occlusion: {losses_per_min: 1}}", InvalidInputError, "occlusion"),
        ("options: {sight: {losses: 1}}", InvalidInputError, "sight.losses"),
        ("seed: one", UnreadableFileError, "seed"),
        ("sed: 1", UnreadableFileError, "sed"),
        ("- 1", UnreadableFileError, "needed keys"),
        ("{", UnreadableFileError, "not YAML"),
        ("preset: storm", InvalidInputError, "choose from calm"),
        ("motion: fast", InvalidInputError, "choose from paper5mm"),
        ("options: {ecg: {colour: 1}}", InvalidInputError, "ecg.colour"),
        ("options: {ecg: {leads: 7}}", InvalidInputError, "needed 1 or 2"),
        ("options: {ecg: 3}", InvalidInputError, "ecg"),
        ("options: {mismatch_mm: .nan}", InvalidInputError, "mismatch_mm"),
        ("schema: other/1", UnreadableFileError, "schema"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        from_text(tmp_path, text)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="does not exist"):
        read_spec(tmp_path / "none.yaml")


def test_print_spec_prints_yaml_and_makes_nothing(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["scenario", "--preset", "poor image", "--seed", "4", "--print-spec"])
    assert done.exit_code == 0
    document = yaml.safe_load(done.stdout)
    assert document["preset"] == "poor-image"
    assert document["seed"] == 4
    assert document["options"]["image"]["clutter"] == 5.0
    path = tmp_path / "spec.yaml"
    path.write_text(done.stdout)
    again = CliRunner().invoke(app, ["scenario", "--spec", str(path), "--print-spec", "--seed", "5"])
    assert again.stdout == done.stdout.replace("seed: 4", "seed: 5")


def test_kind_and_seeds_of_the_heart_are_in_the_yaml_and_read_back(tmp_path: Path) -> None:
    options = ["scenario", "--heart", "dilated", "--seed", "3", "--mismatch-seed", "9", "--print-spec"]
    done = CliRunner().invoke(app, options)
    assert done.exit_code == 0
    assert "anatomy_seed" not in done.stdout
    spec = from_text(tmp_path, done.stdout)
    assert spec.heart == HeartSpec("dilated", mismatch_seed=9)
    assert (spec.seeds.anatomy, spec.seeds.mismatch) == (3, 9)
    for text in ("heart: broken\n", "heart: varied\nanatomy: surfaces\n", "speckle_seed: -1\n"):
        with pytest.raises(InvalidInputError, match=r"heart|seeds"):
            from_text(tmp_path, text)


@pytest.mark.parametrize(
    "options",
    [
        ["--cine", "c.nii", "--labels", "l.nii", "--es-labels", "e.nii@3"],
        ["--voxel-mm", "1.5,1.5,10"],
        ["--anatomy", "cine", "--cine", "c.nii"],
        ["--anatomy", "cine", "--surfaces", "s"],
    ],
)
def test_what_a_cine_needs_belongs_to_it(tmp_path: Path, options: list[str]) -> None:
    assert CliRunner().invoke(app, ["scenario", *options, "-o", str(tmp_path / "out")]).exit_code == 2


def test_without_its_labels_end_systole_is_tracked_in_the_cine(capsys: pytest.CaptureFixture[str]) -> None:
    grid = Grid("mr", (36, 36, 6), np.zeros(3), np.array([2.0, 2.0, 8.0]), np.eye(3))
    away_mm = np.linalg.norm((grid.centers_mm() - grid.to_mm(np.array([17.5, 17.5, 2.5])))[..., :2], axis=-1)
    radii_mm = [20.0, 17.0, 14.0, 16.0, 19.0]
    grey = np.stack([np.where(away_mm < r, 300.0, np.where(away_mm < 30.0, 100.0, 180.0)) for r in radii_mm])
    labels = np.where(away_mm < 20.0, 3, np.where(away_mm < 30.0, 2, 0)).astype(np.uint8)
    series = VolumeSeries(grid, grey.astype(np.float32), CycleTiming(np.arange(5) / 5, 0.8))
    es, phase = first_world._tracked_systole(series, Volume(grid, labels))
    assert phase == 2
    assert (es.values == 3).sum() < 0.7 * (labels == 3).sum()
    assert "end-systole at phase 2" in " ".join(capsys.readouterr().err.split())


def test_end_systolic_labels_come_with_their_phase(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="FILE@PHASE"):
        first_world._on_a_cine(
            ScenarioSpec(), tmp_path / "c.nii", tmp_path / "l.nii", SpecFile(es_labels="e.nii")
        )


def test_without_a_folder_or_with_two_presets_it_is_a_usage_error(tmp_path: Path) -> None:
    assert CliRunner().invoke(app, ["scenario"]).exit_code == 2
    path = tmp_path / "spec.yaml"
    path.write_text("preset: ectopy\n")
    both = ["scenario", "--spec", str(path), "--preset", "calm", "-o", str(tmp_path / "out")]
    assert CliRunner().invoke(app, both).exit_code == 2


def test_the_folder_tells_what_is_in_it_but_no_true_value(
    tmp_path: Path, brief: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("data_synth.phantom_scenario", lambda spec, report: brief)
    out = tmp_path / "made"
    for _ in range(2):  # a folder of ours is replaced
        done = CliRunner().invoke(app, ["scenario", "--preset", "probe slip", "-o", str(out)])
        assert done.exit_code == 0, done.output
    readme = (out / "README.md").read_text()
    for fault in describe_faults(PRESETS["probe-slip"]):
        assert fault in readme
    assert brief.truth is not None
    assert f"{brief.truth.lag_s:.3f}" not in readme
    for path in out.rglob("*"):
        if path.is_file() and path.suffix not in (".md", ".png") and "truth" not in path.parts:
            listed = path.name in readme or any(
                part in readme for part in ("calibration/nwire", path.name.split(".")[0])
            )
            assert listed, path
    assert (out / "preview.png").read_bytes()[:4] == b"\x89PNG"
    spec = scenario_spec(read_spec(out / "truth" / "spec.yaml"))
    assert spec.options == PRESETS["probe-slip"]
    assert len(read_scenario(out).ultrasound) == len(brief.ultrasound)


def test_notes_are_optional_and_reading_ignores_them(tmp_path: Path, brief: Scenario) -> None:
    write_scenario(brief, tmp_path / "plain")
    assert not (tmp_path / "plain" / "README.md").exists()
    assert not (tmp_path / "plain" / "truth" / "spec.yaml").exists()
    write_scenario(brief, tmp_path / "plain", ScenarioNotes())
    assert (tmp_path / "plain" / "README.md").is_file()
    assert not (tmp_path / "plain" / "truth" / "spec.yaml").exists()
