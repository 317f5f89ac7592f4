"""`register --us-volume` on files of the toy heart: the pose that arrays give, and each misuse."""

import json
import re
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pytest
import yaml
from html_outline import outline_of
from toy_heart import CENTER_MM, toy_mr, toy_pose
from toy_volume import toy_volume
from typer.testing import CliRunner, Result

from dvf_ig.cli.main import app
from dvf_ig.core import Grid, Landmarks, Points, Preop, Rigid, Signal, TrackedVolume, Volume, VolumeSeries
from dvf_ig.intake import read_session
from dvf_ig.intake.preop import read_preop
from dvf_ig.intake.schema import PreopConfig
from dvf_ig.io import (
    read_model,
    write_ecg_csv,
    write_landmarks,
    write_model,
    write_timing,
    write_transform,
    write_volume,
    write_volume_series,
)
from dvf_ig.preop import ModelOptions, model_from_preop
from dvf_ig.registration import prior_from_landmarks, target_errors_mm
from dvf_ig.session import build_heart, register_gated_volumes

VIEWS = ((0.5, 0.2, -0.4), (-0.6, 0.9, 0.3))
TARGETS = Points("mr", CENTER_MM + np.random.default_rng(1).uniform(-40, 40, (27, 3)))
PATIENT = "toy"


def cine() -> VolumeSeries:
    mr = toy_mr()
    return VolumeSeries(mr.grid, np.rint(mr.values).astype(np.int16), mr.timing)


def views() -> list[TrackedVolume]:
    """In the tracker's coordinates, as a scanner with a navigation system saves them."""
    return [_in_tracker(toy_volume(turn, seed)) for seed, turn in zip((1, 101), VIEWS, strict=True)]


def _in_tracker(volume: TrackedVolume) -> TrackedVolume:
    pose, grid = volume.tracker_from_image, volume.image.grid
    placed = Grid(
        "tracker",
        grid.shape,
        pose.apply_array(grid.origin_mm),
        grid.spacing_mm,
        pose.rotation @ grid.direction,
    )
    image, mask = (Volume(placed, part.values) for part in (volume.image, volume.mask))
    return replace(volume, image=image, mask=mask, tracker_from_image=Rigid.identity("tracker", "tracker"))


def start_pose() -> Rigid:
    return toy_pose().perturbed_left(np.array([0.1, -0.08, 0.05]), np.array([5.0, -4.0, 3.0]), CENTER_MM)


def touched(noise_mm: float, names: int = 6) -> tuple[Landmarks, Landmarks]:
    marked = Points("mr", TARGETS.xyz_mm[:names])
    off = np.random.default_rng(2).normal(0, noise_mm, (names, 3))
    felt = Points("tracker", toy_pose().inverse().apply(marked).xyz_mm + off)
    named = tuple(f"p{i}" for i in range(names))
    return Landmarks(named, marked), Landmarks(named, felt)


def ecg(rr_s: float = 0.8, beats: int = 14) -> Signal:
    """Narrow spikes on a quiet line."""
    t_s = np.arange(round(rr_s * beats * 500)) / 500.0
    away = (t_s - 0.3 + rr_s / 2) % rr_s - rr_s / 2
    return Signal(np.exp(-0.5 * (away / 0.008) ** 2)[:, None], 500.0, 0.0, ("II",))


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """model.npz, cine.nrrd, a.nrrd (uint8), b.nrrd (float32), start.tfm, landmarks, ecg.csv."""
    folder = tmp_path_factory.mktemp("lab")
    mr = cine()
    labels = np.where(mr.values > 200, 2, np.where(mr.values < 130, 1, 0)).astype(np.uint8)
    preop = Preop(
        PATIENT,
        labels=VolumeSeries(mr.grid, labels, mr.timing),
        label_names=((1, "wall"), (2, "blood")),
        organ_labels=(1, 2),
    )
    still = model_from_preop(preop, options=ModelOptions(6.0, 15.0))
    write_model(replace(still, es_fraction=0.35), folder / "model.npz")
    write_volume_series(mr, folder / "cine.nrrd")
    write_timing(mr.timing, folder / "timing.json")
    first, second = views()
    write_volume(first.image, folder / "a.nrrd")
    write_volume(Volume(second.image.grid, second.image.values.astype(np.float32)), folder / "b.nrrd")
    far = start_pose().perturbed_left(np.zeros(3), np.array([400.0, 0, 0]), CENTER_MM)
    write_transform(start_pose(), folder / "start.tfm")
    write_transform(far, folder / "far.tfm")
    for side, points in zip(("mr", "tracker"), touched(0.4), strict=True):
        write_landmarks(points, folder / f"{side}.mrk.json")
    write_ecg_csv(ecg(), folder / "ecg.csv")
    (folder / "here").mkdir()
    return folder


def run(*words: Any) -> Result:
    return CliRunner().invoke(app, [*map(str, words)])


def register(*words: Any) -> Result:
    return run("register", *words)


def session(lab: Path, folder: Path, *volumes: str, **start: str) -> Path:
    """A session.yaml of volumes and the model; with `mr` and `ecg` these too, the rest is its start."""
    files = {key: str(lab / name) for key, name in start.items()}
    document = {
        "schema": "dvf_ig.session/1",
        "preop": {"model": str(lab / "model.npz"), "mr": files.pop("mr", None)},
        "ultrasound": {"volumes": [str(lab / name) for name in volumes]},
        "ecg": f"csv:{files.pop('ecg')}" if "ecg" in files else None,
        "start": files,
    }
    path = folder / "session.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def pose_in(out: Path) -> tuple[Rigid, dict[str, Any]]:
    payload = json.loads((out / "result.json").read_text())
    return Rigid.from_matrix(payload["mr_from_tracker"], "mr", "tracker"), payload


def expected(lab: Path, *, mr: bool = True, start: Rigid | None = None, **options: Any) -> Rigid:
    """The same registration from arrays."""
    series = cine() if mr else None
    heart = build_heart(Preop(PATIENT, mr=series), read_model(lab / "model.npz"))
    result = register_gated_volumes(
        views(), heart, start or start_pose(), mr=series, seed=0, clock=perf_counter, **options
    )
    return result.target_from_source


@pytest.mark.usefixtures("drawn")
def test_files_give_the_pose_of_arrays(lab: Path, tmp_path: Path) -> None:
    """One volume stored as uint8, one as float32, the model from its file."""
    file = session(lab, tmp_path, "a.nrrd@0", "b.nrrd@0.0", mr="cine.nrrd", transform="start.tfm")
    done = register(file, "--seed", 0, "-o", tmp_path / "out")
    assert done.exit_code == 0, done.output
    found, payload = pose_in(tmp_path / "out")
    np.testing.assert_allclose(found.matrix, expected(lab).matrix, atol=1e-9)
    assert target_errors_mm(found, toy_pose(), TARGETS).mean() < 0.4
    np.testing.assert_allclose(payload["start"], start_pose().matrix, atol=1e-12)
    assert (tmp_path / "out" / "mr_from_tracker.tfm").is_file()
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    outline = outline_of(page)
    assert outline.faults == []
    assert len(outline.images) == 6 * 5
    assert "a.nrrd, b.nrrd" in page
    assert "volume 2, across its third axis" in page
    assert f"<td>{payload['part_disagreement_mm']:.2f} mm</td><td>at most 2.5 mm</td>" in page
    assert payload["outside"].startswith("outside what was calibrated: "), "a toy is unlike any heart"


def test_landmarks_are_start_and_prior_and_times_need_the_ecg(lab: Path, tmp_path: Path) -> None:
    """R peaks at 0.3 + 0.8 k s; the model's own rate, so that a time at R + 0.8 p is the phase p."""
    landmarks = {"landmarks_mr": "mr.mrk.json", "landmarks_tracker": "tracker.mrk.json"}
    file = session(lab, tmp_path, "a.nrrd=4.3", "b.nrrd=5.1", ecg="ecg.csv", **landmarks)
    done = register(file, "--seed", 0, "-o", tmp_path / "out")
    assert done.exit_code in (0, 7), done.output
    marked, felt = touched(0.4)
    found, payload = pose_in(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert re.search(r"<td>\d+\.\d\d mm</td><td>at most 4 mm</td><td class=(passed|failed)>", page)
    assert "colour shows where the model has blood" in page
    assert payload["outside"] == "no probability was calibrated for images of this kind", "labels, not MR"
    start = Rigid.from_matrix(payload["start"], "mr", "tracker")
    prior = prior_from_landmarks(marked, felt)
    assert prior is not None
    wanted = expected(lab, mr=False, start=start, landmarks=prior)
    np.testing.assert_allclose(found.matrix, wanted.matrix, atol=1e-9)
    assert np.linalg.norm(start.apply(felt.points).xyz_mm - marked.points.xyz_mm, axis=1).max() < 1.5


START = {"transform": "start.tfm"}
WRONG: list[tuple[list[str], dict[str, str], int, str]] = [
    (["a.nrrd"], START, 3, "does not say its phase"),
    (["a.nrrd@1.2"], START, 3, "fraction of the RR interval"),
    (["a.nrrd@0", "here/../a.nrrd@0.5"], START, 3, "twice"),
    (["a.nrrd=4.3"], START, 3, "ecg: a registration needs the ECG"),
    (["a.nrrd=99"], {**START, "ecg": "ecg.csv"}, 3, "no heart beat of the ECG"),
    (["a.nrrd@0"], {**START, "ecg": "ecg.csv"}, 3, "it belongs to volumes given as FILE=SECONDS"),
    (["a.nrrd@0"], {}, 3, "start: a registration needs a start"),
    (["a.nrrd@0"], {**START, "touched": "ecg.csv"}, 3, "start.touched: "),
    (["a.nrrd@0"], {"transform": "far.tfm"}, 5, "no ultrasound volume reaches the model"),
    (["none.nrrd@0"], START, 3, "none.nrrd (ultrasound.volumes)"),
    (["cine.nrrd@0"], START, 3, "split it"),
    (["a.nrrd@0"], {**START, "mr": "a.nrrd"}, 3, "needed 4-D"),
]


@pytest.mark.parametrize(("volumes", "files", "code", "says"), WRONG)
def test_misuse_ends_in_one_sentence_and_writes_nothing(
    lab: Path, tmp_path: Path, volumes: list[str], files: dict[str, str], code: int, says: str
) -> None:
    done = register(session(lab, tmp_path, *volumes, **files), "-o", tmp_path / "out")
    assert done.exit_code == code, done.output
    assert says in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_volumes_from_options_give_a_session_that_no_replay_takes(lab: Path, tmp_path: Path) -> None:
    words = ["--us-volume", lab / "a.nrrd@0", "--us-volume", lab / "b.nrrd@0.0", "--model", lab / "model.npz"]
    file = tmp_path / "here" / "session.yaml"
    file.parent.mkdir()
    made = run("config", "init", *words, "--start", lab / "start.tfm", "-o", file)
    assert made.exit_code == 0, made.output
    assert "gated volumes a.nrrd, b.nrrd" in made.stdout
    assert "note: a replay cannot use ultrasound.file: gated volumes give a pose but no force" in made.stderr
    document = yaml.safe_load(file.read_text())
    assert [Path(text.partition("@")[0]).is_absolute() for text in document["ultrasound"]["volumes"]] == [
        False,
        False,
    ]
    assert [volume.path.resolve() for volume in read_session(file).volumes] == [
        (lab / name).resolve() for name in ("a.nrrd", "b.nrrd")
    ]
    assert run("replay", file, "-o", tmp_path / "out").exit_code == 3


def test_times_of_a_cine_without_any_are_the_models(lab: Path, tmp_path: Path) -> None:
    write_volume_series(cine(), tmp_path / "alone.nrrd")
    files = {"model": str(lab / "model.npz"), "mr": str(tmp_path / "alone.nrrd")}
    read = read_preop(PreopConfig.model_validate(files), Path(), None)
    assert read.preop.mr is not None
    assert read.model is not None
    assert read.preop.mr.timing is read.model.timing
