"""`dvf-ig model build --image` as a user types it."""

import json

import numpy as np
import pytest
import SimpleITK
import typer
from toy_ball import ball_model
from typer.testing import CliRunner

from dvf_ig.cli.model import commands as model
from dvf_ig.cli.model.from_image import BuiltModel, FileBeside
from dvf_ig.core import CycleTiming, Grid, OutputError, Volume, VolumeSeries
from dvf_ig.io import read_model, write_timing, write_volume, write_volume_series
from dvf_ig.preop import check_model

app = typer.Typer()
app.add_typer(model.app, name="model")
SCALES = (1.0, 0.9, 0.87, 0.95)
OUTER_MM, INNER_MM = 15.0, 8.0


def run(*args):
    return CliRunner().invoke(app, [str(a) for a in args])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A shell that contracts: image, labels of every phase (1 wall, 2 cavity), of the first alone, seeds."""
    here = tmp_path_factory.mktemp("cine")
    grid = Grid.axis_aligned("mr", (25, 25, 25), np.full(3, -24.0), 2.0)
    r = np.linalg.norm(grid.centers_mm(), axis=-1)
    rng = np.random.default_rng(3)
    images, labels = [], []
    for scale in SCALES:
        q = r / scale
        grey = 300 + 500 / (1 + np.exp((q - INNER_MM) / 0.7)) - 250 / (1 + np.exp((OUTER_MM - q) / 0.7))
        images.append(grey + 20 * rng.standard_normal(grey.shape))
        labels.append(np.where(q < INNER_MM, 2, np.where(q < OUTER_MM, 1, 0)).astype(np.uint8))
    timing = CycleTiming.uniform(4, 0.9)
    write_volume_series(VolumeSeries(grid, np.stack(images).astype(np.int16), timing), here / "cine.nii.gz")
    write_volume_series(VolumeSeries(grid, np.stack(labels), timing), here / "labels.nii.gz")
    write_volume(Volume(grid, labels[0]), here / "ed.nii.gz")
    write_timing(timing, here / "timing.json")
    axes = np.vstack([np.eye(3), -np.eye(3)])
    points = {"heart": 11.5 * axes, "background": 20.0 * axes, "cavity": 2.0 * axes}
    text = json.dumps({name: xyz.tolist() for name, xyz in points.items()})
    (here / "seeds.json").write_text(text, encoding="utf-8")
    return here


def radius_mm(mesh):
    return np.linalg.norm(mesh.vertices_mm, axis=1)


@pytest.mark.usefixtures("drawn")
def test_from_labels_of_end_diastole(folder):
    output = folder / "from_labels.npz"
    image, labels = folder / "cine.nii.gz", folder / "ed.nii.gz"
    result = run(
        "model",
        "build",
        "--image",
        image,
        "--labels",
        labels,
        "--cavity",
        "2",
        "--knot-mm",
        5,
        "-o",
        output,
        "--json",
    )
    assert result.exit_code == 0, result.output
    motion = json.loads(result.stdout)["motion"]
    saved = json.loads((folder / "from_labels.json").read_text(encoding="utf-8"))
    assert (motion | {"kind": "model", "written_by": "dvf_ig"}).items() <= saved.items()
    assert [one["file"] for one in saved["inputs"]] == [image.name, "timing.json", labels.name]
    assert motion["dice"] is None
    assert min(motion["min_jacobian"]) > 0.3
    assert motion["volume_ml"][2] / motion["volume_ml"][0] == pytest.approx(SCALES[2] ** 3, rel=0.06)
    assert (folder / "from_labels.png").stat().st_size > 10_000
    built = read_model(output)
    assert built.es_fraction == 0.5
    for mesh, scale in zip(built.reference, SCALES, strict=True):
        assert np.abs(radius_mm(mesh) - OUTER_MM * scale).mean() < 0.25


def test_labels_of_every_phase_assess_the_motion(folder):
    output = folder / "assessed.npz"
    image, labels = folder / "cine.nii.gz", folder / "labels.nii.gz"
    result = run("model", "build", "--image", image, "--labels", labels, "--knot-mm", 6, "-o", output)
    assert result.exit_code == 0, result.output
    assert "closure error" in result.stdout
    assert "ED surface" in result.stdout
    motion = json.loads((folder / "assessed.json").read_text(encoding="utf-8"))
    assert min(motion["dice"]) > min(motion["dice_before"]) + 0.05
    named = [line[:16] for line in result.stdout.splitlines()]
    assert named.index("anatomical error") == named.index("spline fit error") + 1
    assert motion["anatomical_error_mm"]["phases"] == [1, 2, 3]
    assert motion["anatomical_error_mm"]["mean"] < 0.5  # a quarter of a voxel
    assert "give --cavity (1: " in result.stderr


def test_segments_named_blood_are_the_cavity(folder):
    """A segmentation of 3D Slicer says what its labels are; no option does."""
    labels = SimpleITK.ReadImage(str(folder / "ed.nii.gz"))
    for n, name in enumerate(("Wall", "LV Blood pool")):
        labels.SetMetaData(f"Segment{n}_Name", name)
        labels.SetMetaData(f"Segment{n}_LabelValue", str(n + 1))
        labels.SetMetaData(f"Segment{n}_Layer", "0")
    SimpleITK.WriteImage(labels, str(folder / "ed.seg.nrrd"))
    output = folder / "named.npz"
    files = ("--image", folder / "cine.nii.gz", "--labels", folder / "ed.seg.nrrd")
    result = run("model", "build", *files, "--knot-mm", 6, "-o", output, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["chambers"] == ["LV Blood pool"]
    assert json.loads(result.stdout)["anatomical_error_mm"] is None
    assert "where the blood is" not in result.stderr
    (chamber,) = read_model(output).chambers
    for mesh, scale in zip(chamber.surfaces, SCALES, strict=True):
        assert np.abs(radius_mm(mesh) - INNER_MM * scale).mean() < 0.4


def test_the_cavity_of_labels_of_every_phase(folder):
    files = ("--labels", folder / "labels.nii.gz", "--organ", "1,2", "--timing", folder / "timing.json")
    for more, chambers in ((("--cavity", 2), ["label 2"]), ((), [])):
        result = run("model", "build", *files, *more, "--knot-mm", 6, "-o", folder / "all.npz", "--json")
        assert result.exit_code == 0, result.output
        assert json.loads(result.stdout)["chambers"] == chambers
        assert ("give --cavity" in result.stderr) == (not chambers)


def test_from_seeds(folder):
    output = folder / "grown.npz"
    image, seeds = folder / "cine.nii.gz", folder / "seeds.json"
    result = run("model", "build", "--image", image, "--seeds", seeds, "--knot-mm", 6, "-o", output, "--json")
    assert result.exit_code == 0, result.output
    assert (folder / "grown_ed_labels.nii.gz").is_file()
    assert np.abs(radius_mm(read_model(output).reference[0]) - OUTER_MM).mean() < 0.8


@pytest.mark.parametrize(
    ("given", "code", "message"),
    [
        ((), 2, "--labels SERIES, or --image"),
        (("--image", "cine.nii.gz"), 2, "needs either"),
        (("--surfaces", "seeds.json", "--cavity", "2"), 2, "belong to --labels; surfaces"),
        (("--seeds", "seeds.json", "--labels", "ed.nii.gz", "--organ", "1,2"), 2, "needs --image"),
        (("--image", "cine.nii.gz", "--labels", "ed.nii.gz", "--motion", "magic"), 2, "magic"),
        (("--image", "cine.nii.gz", "--seeds", "seeds.json", "--organ", "1"), 2, "belong to --labels"),
        (("--image", "cine.nii.gz", "--labels", "ed.nii.gz", "--organ", "9"), 3, "no voxel of the organ"),
        (("--image", "cine.nii.gz", "--labels", "ed.nii.gz", "--ed-phase", "7"), 3, "phases 0 to 3"),
        (("--image", "ed.nii.gz", "--labels", "ed.nii.gz"), 3, "needed 4-D"),
    ],
)
def test_refusals(folder, given, code, message):
    arguments = [folder / a if a.endswith((".gz", ".json")) else a for a in given]
    result = run("model", "build", *arguments, "-o", folder / "refused.npz")
    assert result.exit_code == code, result.output
    assert message in " ".join(result.output.replace("│", " ").split())
    assert not (folder / "refused.npz").exists()


def test_labels_on_another_grid_are_refused(folder):
    grid = Grid.axis_aligned("mr", (25, 25, 25), np.full(3, -21.0), 2.0)
    write_volume(Volume(grid, np.ones(grid.shape, dtype=np.uint8)), folder / "moved.nii.gz")
    result = run(
        *("model", "build", "--image", folder / "cine.nii.gz", "--labels", folder / "moved.nii.gz"),
        *("-o", folder / "refused.npz"),
    )
    assert result.exit_code == 3
    assert "1.00 mm from the 4-D image's" in " ".join(result.output.split())


def test_a_model_and_its_evidence_are_written_together_or_not_at_all(tmp_path, monkeypatch):
    beside = FileBeside(tmp_path / "heart.json", lambda path: path.write_text("{}"))
    built = BuiltModel(ball_model(), {}, (beside,), (tmp_path / "heart.png",))
    monkeypatch.setattr("dvf_ig.cli.model.sources.model_of", lambda *_, **__: built)
    checked = check_model(ball_model(), points_per_phase=20, rng=np.random.default_rng(0))
    monkeypatch.setattr(model, "_errors", lambda *_: checked)
    arguments = ("model", "build", "--surfaces", tmp_path, "-o", tmp_path / "heart.npz")

    def full(*_):
        raise OutputError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr("dvf_ig.io.write_model", full)
        result = run(*arguments)
        assert result.exit_code == 4, result.output
    assert list(tmp_path.iterdir()) == []
    assert run(*arguments).exit_code == 0
    assert {path.name for path in tmp_path.glob("h*")} == {"heart.json", "heart.npz"}


def test_a_user_s_own_file_beside_the_model_is_kept(folder, monkeypatch):
    """It is refused before the motion is estimated, which takes long."""
    monkeypatch.setattr("dvf_ig.preop.cine_model.track_cycle", lambda *_, **__: pytest.fail("too late"))
    mine = folder / "mine.json"
    mine.write_text("{}", encoding="utf-8")
    result = run(
        *("model", "build", "--image", folder / "cine.nii.gz", "--labels", folder / "ed.nii.gz"),
        *("-o", folder / "mine.npz"),
    )
    assert result.exit_code == 4, result.output
    assert mine.read_text(encoding="utf-8") == "{}"
    assert not (folder / "mine.npz").exists()
