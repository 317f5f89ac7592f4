"""Kept pairs: a user's command on the files of a trial gives that trial's error."""

import json
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stub_registration import TARGETS
from toy_heart import CENTER_MM, toy_mr, toy_pose
from toy_volume import toy_volume
from typer.testing import CliRunner

import dvf_ig.study.registration.pair_files as pair_files
import dvf_ig.study.registration.problem as problems
import dvf_ig.study.registration.trial as trials
from dvf_ig.cli.main import app
from dvf_ig.core import Landmarks, Preop, TrackedVolume, VolumeSeries
from dvf_ig.io import read_gated_volumes, read_landmarks, read_transform
from dvf_ig.preop import ModelOptions, model_from_preop
from dvf_ig.study.registration.experiments import CAPTURE, CaptureOptions, settings_of, trial_numbers
from dvf_ig.study.registration.pair_files import keep_pairs
from dvf_ig.study.registration.trial import registration_trial

SETTINGS = settings_of(CAPTURE, CaptureOptions(per_bin=1, to_mm=4.0))
VIEWS = ((0.5, 0.2, -0.4), (-0.6, 0.9, 0.3))


class ToyPair:
    """The toy heart in the place of a phantom: two views, still through the cycle."""

    def __init__(self, spec: Any) -> None:
        mr = toy_mr()
        codes = np.where(mr.values > 200, 2, np.where(mr.values < 130, 1, 0)).astype(np.uint8)
        self.spec = spec
        self.mr_from_tracker = toy_pose()
        self.center_mm = CENTER_MM
        self.targets = Landmarks(tuple(f"t{i}" for i in range(len(TARGETS))), TARGETS)
        self.preop = Preop(
            "toy",
            mr=mr,
            labels=VolumeSeries(mr.grid, codes, mr.timing),
            label_names=((1, "wall"), (2, "blood")),
            organ_labels=(1, 2),
        )

    def volumes(self, phases: tuple[float, ...], phase_error: float = 0.0) -> tuple[TrackedVolume, ...]:
        seen = [toy_volume(turn, seed) for turn, seed in zip(VIEWS, (1, 101), strict=True)]
        return tuple(replace(view, model_phase=phase) for view, phase in product(seen, phases))


@pytest.fixture
def toy_pairs(monkeypatch: pytest.MonkeyPatch) -> Any:
    for module in (problems, pair_files):
        monkeypatch.setattr(module, "image_pair", ToyPair)
    coarse = partial(model_from_preop, options=ModelOptions(8.0, 15.0))
    monkeypatch.setattr(pair_files, "model_from_preop", coarse)
    for cached in (trials._problem, problems._preoperative):
        cached.cache_clear()
    yield
    for cached in (trials._problem, problems._preoperative):
        cached.cache_clear()


def test_the_files_of_a_trial_give_its_error(toy_pairs: None, tmp_path: Path) -> None:
    number = trial_numbers(SETTINGS, 1, 1)[1]
    line = registration_trial(SETTINGS, number)
    (place,) = keep_pairs(SETTINGS, [number], tmp_path, lambda _: None)
    assert place == tmp_path / "pair-1-paper5mm-calm"
    volumes = [
        part
        for file in sorted(place.glob("*-0.??.nrrd"))
        for part in ("--us-volume", f"{file}@{file.stem[-4:]}")
    ]
    assert len(volumes) == 12
    heart = ["--cine", place / "cine.nrrd", "--labels", place / "labels.nrrd", "--cavity", 2]
    given = [*heart, "--start", place / f"start-{number}.tfm", "-o", tmp_path / "session.yaml"]
    made = CliRunner().invoke(app, ["config", "init", *map(str, given), *volumes])
    assert made.exit_code == 0, made.output
    words = [tmp_path / "session.yaml", "--seed", number, "-o", tmp_path / "out"]
    done = CliRunner().invoke(app, ["register", *map(str, words)])
    assert done.exit_code in (0, 7), done.output
    sides = [str(place / f"targets_{side}.mrk.json") for side in ("tracker", "mr")]
    measured = CliRunner().invoke(
        app, ["evaluate", "--transform", str(tmp_path / "out"), "--landmarks", *sides, "--json"]
    )
    found = json.loads(measured.stdout)
    assert found["start_tre_mm"]["mean"] == pytest.approx(line["start_mm"], abs=1e-6)
    # the study turns poses about the centre of the phantom's box, a user's about that of the model's
    assert found["tre_mm"]["mean"] == pytest.approx(line["tre_mm"], abs=5e-3)
    assert line["stop"] == json.loads((tmp_path / "out" / "result.json").read_text())["stop"]


def test_the_files_hold_the_pair(toy_pairs: None, tmp_path: Path) -> None:
    pair_files.write_pair(ToyPair(None), ToyPair(None).volumes(problems.GATED), tmp_path / "pair")
    files = sorted((tmp_path / "pair").glob("apical*-0.35.nrrd"))
    (volume,) = read_gated_volumes(files, [0.35])
    (original,) = [v for v in ToyPair(None).volumes(problems.GATED)[:3] if v.model_phase == 0.35]
    np.testing.assert_array_equal(volume.image.values, original.image.values)
    index = np.array([[3.0, 5.0, 7.0]])
    np.testing.assert_allclose(
        volume.image.grid.to_mm(index),
        original.tracker_from_image.apply_array(original.image.grid.to_mm(index)),
        atol=1e-9,
    )
    truth = read_transform(tmp_path / "pair" / "truth.tfm")
    marked, felt = (read_landmarks(tmp_path / "pair" / f"targets_{s}.mrk.json", s) for s in ("mr", "tracker"))
    np.testing.assert_allclose(truth.apply(felt.points).xyz_mm, marked.points.xyz_mm, atol=1e-9)
