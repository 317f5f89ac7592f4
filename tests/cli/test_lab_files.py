"""Files as labs keep them, each given to the command that a new user would type."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner, Result

from dvf_ig.cardiac import detect_r_peaks
from dvf_ig.cli.main import app
from dvf_ig.core import DvfModel, Landmarks, Points, Rigid, SurfaceSeries, Volume, VolumeSeries
from dvf_ig.io import (
    read_ecg,
    read_model,
    read_seeds,
    read_sequence,
    write_landmarks,
    write_model,
    write_surface_series,
    write_transform,
)
from dvf_ig.preop import CineModel, model_from_cine


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [*map(str, arguments)])


def found(*arguments: object) -> dict[str, Any]:
    """The JSON that a command prints."""
    done = run(*arguments, "--json")
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.stdout))


def refused(*arguments: object, code: int = 3) -> str:
    """The one sentence of a command that must not go on."""
    done = run(*arguments)
    assert done.exit_code == code, done.output
    text = " ".join(done.output.replace("│", " ").split())
    told = [line for line in done.stderr.strip().splitlines() if not line.startswith("note: ")]
    assert code != 3 or len(told) == 1
    return text


# ECG


@pytest.fixture(scope="module")
def beats() -> np.ndarray:
    """20 s of a peak every 0.8 s at 250 Hz."""
    t = np.arange(5000) / 250.0
    x = np.exp(-0.5 * (((t + 0.4) % 0.8 - 0.4) / 0.012) ** 2)
    return np.asarray(x + 0.01 * np.random.default_rng(0).standard_normal(len(t)))


ROWS = {
    "Timestamp,ECG": ("Timestamp,ECG", lambda i, x: f"{i * 0.004:.3f},{x:.5f}"),
    "semicolons, decimal commas": ("t;EKG", lambda i, x: f"{i * 0.004:.3f};{x:.5f}".replace(".", ",")),
    "ms in the name": ("time [ms],II (mV)", lambda i, x: f"{4 * i},{x:.5f}"),
    "ms by the step": ("Timestamp\tECG", lambda i, x: f"{4 * i}\t{x:.5f}"),
    "no header": (None, lambda i, x: f"{i * 0.004:.3f},{x:.5f}"),
    "epoch": ("time,ECG", lambda i, x: f"{1_700_000_000 + i * 0.004:.3f},{x:.5f}"),
}
ROWS_WITHOUT_TIMES = {
    "no header": (None, lambda i, x: f"{x:.5f}"),
    "one column, decimal commas": (None, lambda i, x: f"{x:.5f}".replace(".", ",")),
    "a name alone": ("ECG", lambda i, x: f"{x:.5f}"),
    "sample numbers": ("'sample #','MLII'", lambda i, x: f"{i},{x:.5f}"),
    "bare sample numbers": (None, lambda i, x: f"{i};{x:.5f}"),
}


def table(path: Path, kind: tuple[Any, Any], beats: np.ndarray) -> Path:
    header, row = kind
    lines = [row(i, x) for i, x in enumerate(beats.tolist())]
    path.write_text("\n".join([*([header] if header else []), *lines]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", ROWS)
def test_an_ecg_table_with_times(kind: str, beats: np.ndarray, tmp_path: Path) -> None:
    path = table(tmp_path / "ecg.csv", ROWS[kind], beats)
    for spec in (path, f"csv:{path}"):
        assert found("gate", spec)["rate_bpm"] == pytest.approx(75, abs=0.1)
    told = found("inspect", path)
    assert told["rate_hz"] == pytest.approx(250, rel=1e-6)
    assert len(told["leads"]) == 1
    signal = read_ecg(str(path))
    np.testing.assert_allclose(signal.samples[:, 0], beats, atol=1e-5)
    assert signal.unit == "mV"


@pytest.mark.parametrize("kind", ROWS_WITHOUT_TIMES)
def test_an_ecg_table_without_times_needs_its_rate(kind: str, beats: np.ndarray, tmp_path: Path) -> None:
    path = table(tmp_path / "ecg.csv", ROWS_WITHOUT_TIMES[kind], beats)
    assert "--rate" in refused("gate", path)
    assert found("gate", path, "--rate", 250)["rate_bpm"] == pytest.approx(75, abs=0.1)
    assert found("inspect", path, "--rate", 250)["rate_hz"] == 250
    np.testing.assert_allclose(read_ecg(str(path), 250.0).samples, beats[:, None], atol=1e-5)


def test_a_rate_that_cannot_be_is_refused(beats: np.ndarray, tmp_path: Path) -> None:
    path = table(tmp_path / "ecg.csv", ROWS["Timestamp,ECG"], beats)
    assert "at 250 Hz, but --rate is 500 Hz" in refused("gate", path, "--rate", 500)
    trigger = tmp_path / "trigger.csv"
    trigger.write_text("0.1\n0.9\n1.7\n")
    assert "times of pulses" in refused("gate", f"trigger:{trigger}", "--rate", 500)
    out = tmp_path / "out.json"
    assert "does not exist" in refused("gate", "wfdb:none", "--rate", 360, "-o", out)
    assert not out.exists()


def test_a_real_record_by_any_of_its_names(data_dir: Path, tmp_path: Path) -> None:
    record = data_dir / "mitdb-ds1" / "101"
    told = [found("inspect", name) for name in (f"{record}.dat", f"{record}.hea", record, f"wfdb:{record}")]
    assert all({**facts, "file": ""} == {**told[0], "file": ""} for facts in told)
    signal = read_ecg(f"{record}.dat").between(0.0, 30.0)
    rows = [
        f"{1000 * t:.0f};{a:.3f};{b:.3f}".replace(".", ",")
        for t, (a, b) in zip(signal.t_s, signal.samples, strict=True)
    ]
    path = tmp_path / "101.csv"
    path.write_text("Timestamp (ms);MLII;V1\n" + "\n".join(rows) + "\n")
    exported = found("gate", path)["beats_s"]
    own = [peak.t_s for peak in detect_r_peaks(signal)]
    np.testing.assert_allclose(exported, own, atol=0.005)
    assert len(exported) > 30


# labels of end-diastole beside a cine


@pytest.fixture(scope="module")
def cine(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A real cine and the expert's labels of end-diastole, cut to the heart and to every tenth frame."""
    folder, source = tmp_path_factory.mktemp("cine"), data_dir / "acdc-cine" / "patient002"
    grey = SimpleITK.ReadImage(str(source / "cine_4d.nii.gz"))
    labels = SimpleITK.ReadImage(str(source / "ed_labels.nii.gz"))
    inside = np.argwhere(SimpleITK.GetArrayViewFromImage(labels) > 0)[:, ::-1]
    low, high = (np.maximum(inside.min(axis=0) - 8, 0).tolist(), (inside.max(axis=0) + 9).tolist())
    x, y = slice(low[0], high[0]), slice(low[1], high[1])
    SimpleITK.WriteImage(grey[x, y, :, 0:30:10], str(folder / "cine.nii.gz"))
    SimpleITK.WriteImage(labels[x, y, :], str(folder / "ed.nii.gz"))
    return folder


@pytest.fixture
def built_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first model is that of all later ones, which are to be given the same: building it takes long."""
    before: list[tuple[tuple[Any, ...], CineModel]] = []

    def build(image: VolumeSeries, labels: Volume, **given: Any) -> CineModel:
        options = given["options"]
        chosen = (options.organ_labels, options.cavity_labels, options.motion, options.model)
        now = (image.values, labels.values, labels.grid.to_mm(np.eye(3)), *chosen)
        if not before:
            before.append((now, model_from_cine(image, labels, **given)))
        first, model = before[0]
        for one, other in zip(now, first, strict=True):
            np.testing.assert_array_equal(one, other)
        return model

    monkeypatch.setattr("dvf_ig.preop.model_from_cine", build)


@pytest.mark.usefixtures("built_once")
def test_real_labels_of_end_diastole_in_every_form_give_one_model(cine: Path, tmp_path: Path) -> None:
    labels = SimpleITK.ReadImage(str(cine / "ed.nii.gz"))
    names = dict(enumerate(("RV", "myocardium", "LV"), start=1))
    cropped = labels[5:-5, 5:-5, :]
    for n, name in names.items():
        cropped.SetMetaData(f"Segment{n - 1}_Name", name)
        cropped.SetMetaData(f"Segment{n - 1}_LabelValue", str(n))
        cropped.SetMetaData(f"Segment{n - 1}_Layer", "0")
    SimpleITK.WriteImage(cropped, str(tmp_path / "ed.seg.nrrd"))
    SimpleITK.WriteImage(SimpleITK.DICOMOrient(labels, "PIR"), str(tmp_path / "turned.nrrd"))
    layered(tmp_path / "layers.seg.nrrd", labels, [[(name, n)] for n, name in names.items()])
    build = ("model", "build", "--image", cine / "cine.nii.gz", "--organ", "2,3", "--knot-mm", 8, "--labels")
    errors = []
    for path in (
        cine / "ed.nii.gz",
        tmp_path / "ed.seg.nrrd",
        tmp_path / "turned.nrrd",
        tmp_path / "layers.seg.nrrd",
    ):
        told = found(*build, path, "--cavity", 3, "-o", tmp_path / "heart.npz")
        errors.append((told["motion"]["volume_ml"], told["surface_error_mm"]["mean"]))
    assert errors[0][0][0] > 100  # a dilated ventricle, ml
    assert all(other == errors[0] for other in errors[1:])


def layered(path: Path, labels: SimpleITK.Image, layers: list[list[tuple[str, int]]]) -> None:
    """Segments in layers, each segment with the value that it has in `labels`, as 3D Slicer stores them."""
    values = SimpleITK.GetArrayFromImage(labels)
    stacked = np.stack(
        [np.where(np.isin(values, [v for _, v in layer]), values, 0) for layer in layers], axis=-1
    )
    axes = np.array(labels.GetDirection()).reshape(3, 3) * labels.GetSpacing()
    columns = [",".join(map(repr, axes[:, a].tolist())) for a in range(3)]
    header = ["NRRD0004", "type: uchar", "dimension: 4", "space: left-posterior-superior"]
    header += [
        f"sizes: {len(layers)} {' '.join(map(str, labels.GetSize()))}",
        "kinds: list domain domain domain",
    ]
    header += [f"space directions: none ({columns[0]}) ({columns[1]}) ({columns[2]})", "encoding: raw"]
    header += [f"space origin: ({','.join(map(repr, labels.GetOrigin()))})"]
    segments = [(layer, name, value) for layer, listed in enumerate(layers) for name, value in listed]
    for n, (layer, name, value) in enumerate(segments):
        fields = {"Name": name, "LabelValue": value, "Layer": layer}
        header += [f"Segment{n}_{key}:={text}" for key, text in fields.items()]
    path.write_bytes("\n".join([*header, "", ""]).encode() + stacked.astype(np.uint8).tobytes())


def test_labels_that_do_not_fit_the_cine_are_refused(cine: Path, tmp_path: Path) -> None:
    labels = SimpleITK.ReadImage(str(cine / "ed.nii.gz"))
    alone = run("model", "build", "--labels", cine / "ed.nii.gz", "--organ", 2, "-o", tmp_path / "still.npz")
    assert alone.exit_code == 0, alone.output
    assert "so still does not beat; if it does, also give" in " ".join(alone.stderr.split())
    build = ("model", "build", "--image", cine / "cine.nii.gz", "-o", tmp_path / "m.npz", "--labels")
    SimpleITK.WriteImage(SimpleITK.ConstantPad(labels, (2, 0, 0), (0, 0, 0)), str(tmp_path / "wide.nrrd"))
    assert "beyond the 4-D image by up to 2 voxels" in refused(*build, tmp_path / "wide.nrrd")
    SimpleITK.WriteImage(SimpleITK.Expand(labels, (2, 2, 1)), str(tmp_path / "fine.nrrd"))
    assert "another size or direction" in refused(*build, tmp_path / "fine.nrrd")
    layered(tmp_path / "overlap.seg.nrrd", labels, [[("muscle", 2)], [("also muscle", 2)]])
    assert "segment 'also muscle' overlaps another" in refused(*build, tmp_path / "overlap.seg.nrrd")
    assert not list(tmp_path.glob("m*"))


def test_seeds_of_one_name_are_several_seeds(cine: Path, tmp_path: Path) -> None:
    labels = SimpleITK.ReadImage(str(cine / "ed.nii.gz"))
    values = SimpleITK.GetArrayViewFromImage(labels)
    rng = np.random.default_rng(0)
    rows = []
    for name, value in (("heart", 2), ("cavity", 3), ("background", 0)):
        for k, j, i in rng.permutation(np.argwhere(values == value))[:40].tolist():
            x, y, z = labels.TransformIndexToPhysicalPoint((i, j, k))
            rows.append((name, x, y, z))
    head = "# CoordinateSystem = LPS\n# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label\n"
    (tmp_path / "seeds.fcsv").write_text(
        head + "".join(f"{n},{x},{y},{z},0,0,0,1,1,1,0,{name}\n" for n, (name, x, y, z) in enumerate(rows))
    )
    points = [{"label": name, "position": [-x, -y, z]} for name, x, y, z in rows]
    markups = {"markups": [{"type": "Fiducial", "coordinateSystem": "RAS", "controlPoints": points}]}
    (tmp_path / "seeds.mrk.json").write_text(json.dumps(markups))
    seen = [read_seeds(tmp_path / name) for name in ("seeds.fcsv", "seeds.mrk.json")]
    for seeds in seen:
        assert (len(seeds.heart), len(seeds.cavity), len(seeds.background)) == (40, 40, 40)
        np.testing.assert_allclose(seeds.heart.xyz_mm, [row[1:] for row in rows[:40]])
    (tmp_path / "bad.fcsv").write_text(head + "0,1,2,3,0,0,0,1,1,1,0,liver\n")
    build = ("model", "build", "--image", cine / "cine.nii.gz", "-o", tmp_path / "m.npz", "--seeds")
    assert "a seed is named 'liver'" in refused(*build, tmp_path / "bad.fcsv")


# Git-LFS

POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 1234567\n"
LFS_FILES = [
    "sweep.igs.mha",
    "mr.nii.gz",
    "mr.nrrd",
    "mesh.stl",
    "model.npz",
    "start.tfm",
    "ecg.edf",
    "100.hea",
]
LFS_FILES += ["ecg.csv", "points.mrk.json", "points.fcsv", "device.xml", "poses.txt"]


@pytest.mark.parametrize("name", LFS_FILES)
def test_a_git_lfs_pointer_is_named(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(POINTER)
    text = refused("inspect", tmp_path / name)
    assert "is a Git-LFS pointer" in text
    assert "git lfs pull" in text


def test_a_git_lfs_pointer_beside_a_header_is_named(tmp_path: Path, data_dir: Path) -> None:
    (tmp_path / "101.hea").write_bytes((data_dir / "mitdb-ds1" / "101.hea").read_bytes())
    (tmp_path / "101.dat").write_bytes(POINTER)
    assert "101.dat is a Git-LFS pointer" in refused("gate", tmp_path / "101.dat")
    for name, voxels in (("mr.mhd", "mr.raw"), ("mr.nhdr", "mr.raw")):
        SimpleITK.WriteImage(SimpleITK.Image(20, 20, 20, SimpleITK.sitkInt16), str(tmp_path / name))
        (tmp_path / voxels).write_bytes(POINTER)
        assert "mr.raw is a Git-LFS pointer" in refused("inspect", tmp_path / name)


# points and seeds


def test_force_at_points_of_slicer(ball: DvfModel, tmp_path: Path) -> None:
    write_model(ball, tmp_path / "ball.npz")
    lps = np.array([[1.0, 2.0, 9.0], [3.0, -4.0, 8.0]])
    (tmp_path / "p.csv").write_text("\n".join(",".join(map(str, row)) for row in lps.tolist()) + "\n")
    ras = lps * (-1, -1, 1)
    rows = [f"{i},{x},{y},{z},0,0,0,1,1,1,0,tip" for i, (x, y, z) in enumerate(ras.tolist())]
    (tmp_path / "ras.fcsv").write_text(
        "# CoordinateSystem = RAS\n# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label\n"
        + "\n".join(rows)
        + "\n"
    )
    write_landmarks(Landmarks(("a", "b"), Points("mr", lps)), tmp_path / "lps.mrk.json")
    answers = [
        found("force", tmp_path / "ball.npz", "--points", tmp_path / name, "--phase", 0.2)
        for name in ("p.csv", "ras.fcsv", "lps.mrk.json")
    ]
    read = [[one["file"] for one in answer.pop("inputs")] for answer in answers]
    assert read == [["ball.npz", name] for name in ("p.csv", "ras.fcsv", "lps.mrk.json")]
    assert answers[0] == answers[1] == answers[2]
    (tmp_path / "none.fcsv").write_text("# CoordinateSystem = LPS\n")
    text = refused("force", tmp_path / "ball.npz", "--points", tmp_path / "none.fcsv", "--phase", 0.2)
    assert "holds no points" in text


# a model's patient


def test_a_model_takes_the_patient_that_is_named(
    beating_sphere: SurfaceSeries, written: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "surfaces"
    write_surface_series(beating_sphere, folder)
    files = ("--surfaces", folder, "--surface", beating_sphere.name, "--knot-mm", 8)
    for name, more in (("file", ()), ("named", ("--patient", "P-17"))):
        done = run("model", "build", *files, *more, "-o", tmp_path / f"{name}.npz")
        assert done.exit_code == 0, done.output
    assert read_model(tmp_path / "file.npz").patient_id == "unknown"
    assert read_model(tmp_path / "named.npz").patient_id == "P-17"
    for command in ("register", "replay"):
        text = refused(command, written, "--model", tmp_path / "named.npz", "-o", tmp_path / "out")
        assert "the model of patient 'P-17', needed patient '" in text
        assert "--patient '" in text
        assert not (tmp_path / "out").exists()


# calibration of the probe


@pytest.fixture(scope="module")
def cross_wire(calibration_recordings: Path) -> tuple[Path, Path]:
    """A tracked sequence of a cross-wire and its points."""
    folder = calibration_recordings / "cross-wire"
    return folder / "cross-wire.igs.mha", folder / "cross-wire_points.csv"


def test_a_cross_wire_as_two_text_tables(cross_wire: tuple[Path, Path], tmp_path: Path) -> None:
    sequence, points = cross_wire
    command = ("calibrate", "probe", "--phantom", "cross-wire")
    whole = found(*command, sequence, "--points", points)
    poses = read_sequence(sequence).poses["tracker_from_probe"]
    quaternion = Rotation.from_matrix(poses.rotations).as_quat()
    np.savetxt(tmp_path / "poses.txt", np.column_stack([poses.translations_mm, quaternion]), fmt="%.17g")
    rows = [row.split(",")[1:] for row in points.read_text().splitlines()[1:]]
    pixels = tmp_path / "pixels.txt"
    pixels.write_text("\n".join(" ".join(cell or "nan" for cell in row) for row in rows) + "\n")
    for table_of_points in (points, pixels):
        apart = found(*command, tmp_path / "poses.txt", "--points", table_of_points)
        assert apart["sensor_frame"] == whole["sensor_frame"] == "probe"
        np.testing.assert_allclose(apart["sensor_from_image"], whole["sensor_from_image"], atol=1e-6)
    pixels.write_text("u,v\n1,2\n")
    assert "needed frame, column1_px" in refused(*command, tmp_path / "poses.txt", "--points", pixels)
    refused(*command, tmp_path / "poses.txt")


def test_a_probe_and_a_reference_under_other_names(cross_wire: tuple[Path, Path], tmp_path: Path) -> None:
    sequence, points = cross_wire
    command = ("calibrate", "probe", "--phantom", "cross-wire", "--points", points)
    usual = found(*command, sequence)
    other = tmp_path / "other.igs.mha"
    other.write_bytes(sequence.read_bytes().replace(b"ProbeToTracker", b"UltrasoundHeadToStepper"))
    assert "--probe-name, --reference-name" in refused(*command, other)
    names = ("--probe-name", "UltrasoundHead", "--reference-name", "Stepper")
    named = found(*command, other, *names)
    assert named["sensor_frame"] == "ultrasound_head"
    assert named["sensor_from_image"] == usual["sensor_from_image"]
    assert list(found("inspect", other, *names)["probe"]) == ["stepper_from_ultrasound_head"]
    assert "belong to a tracked sequence" in refused("inspect", points, *names)


def test_a_real_stepper_has_neither_name(data_dir: Path) -> None:
    sequence = next((data_dir / "plus-nwire-segmentation").glob("*.igs.mha"))
    assert "it records tracker_from_tool" in refused("inspect", sequence, "--reference-name", "Tracker")
    told = found("inspect", sequence, "--probe-name", "Tool", "--reference-name", "Tracker")
    assert list(told["probe"]) == ["tracker_from_tool"]


# evaluate


def test_evaluate_tells_the_start_and_suspects_swapped_sides(tmp_path: Path) -> None:
    pose = Rigid.from_rotation_vector([0.3, -0.2, 0.5], [20.0, -10.0, 30.0], "moving", "fixed")
    write_transform(pose, tmp_path / "found.tfm")
    write_transform(
        Rigid("moving", "fixed", pose.rotation, np.add(pose.translation_mm, (3, 0, 4))),
        tmp_path / "start.tfm",
    )
    names = tuple(f"p{i}" for i in range(5))
    fixed = Points("fixed", np.random.default_rng(1).normal(0, 40, (5, 3)))
    write_landmarks(Landmarks(names, fixed), tmp_path / "fixed.mrk.json")
    write_landmarks(Landmarks(names, pose.apply(fixed)), tmp_path / "moving.mrk.json")
    sides = (tmp_path / "fixed.mrk.json", tmp_path / "moving.mrk.json")
    command = ("evaluate", "--transform", tmp_path / "found.tfm", "--landmarks")
    without = found(*command, *sides)
    assert without["start_tre_mm"] is None
    told = run(*command, *sides, "--start", tmp_path / "start.tfm")
    assert "TRE at the start  5.00 mm mean, 5.00 worst" in told.stdout
    assert "swapped" not in told.output
    (tmp_path / "found.result.json").write_text(
        json.dumps({"moving_from_fixed": pose.matrix.tolist(), "start": np.eye(4).tolist()})
    )
    far = np.linalg.norm(pose.apply(fixed).xyz_mm - fixed.xyz_mm, axis=1).mean()
    assert found(*command, *sides)["start_tre_mm"]["mean"] == pytest.approx(far)
    swapped = run(*command, *sides[::-1])
    assert swapped.exit_code == 0
    assert "fixed and moving are probably swapped" in swapped.stderr
    assert len(swapped.stderr.strip().splitlines()) == 1
