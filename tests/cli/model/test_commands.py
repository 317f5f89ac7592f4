"""`dvf-ig model` and `dvf-ig force` as a user types them."""

import base64
import json
from xml.etree import ElementTree

import numpy as np
import pytest
import SimpleITK
import typer
from scipy.spatial import KDTree
from typer.testing import CliRunner

from dvf_ig.cli import force
from dvf_ig.cli.model import commands as model
from dvf_ig.core import CycleTiming, Grid, Mesh, Volume, VolumeSeries
from dvf_ig.io import (
    read_model,
    write_mesh,
    write_surface_series,
    write_timing,
    write_volume,
    write_volume_series,
)

app = typer.Typer()
app.add_typer(model.app, name="model")
app.command("force")(force.force)


def run(*args):
    return CliRunner().invoke(app, [str(a) for a in args])


@pytest.fixture(scope="module")
def built(beating_sphere, tmp_path_factory):
    folder = tmp_path_factory.mktemp("surfaces")
    write_surface_series(beating_sphere, folder)
    write_timing(beating_sphere.timing, folder / "timing.json")
    output = folder / "model.npz"
    result = run("model", "build", "--surfaces", folder, "-o", output, "--json")
    assert result.exit_code == 0, result.output
    return output, json.loads(result.stdout)


def test_build_reports_the_surface_error(built):
    output, report = built
    assert output.is_file()
    assert report["phases"] == 3
    assert report["surface_error_mm"]["mean"] < 0.02
    assert len(report["surface_error_mm"]["per_phase"]) == 3
    assert report["megabytes"] > 0
    assert report["seconds"] > 0
    assert report["rr_s"] == pytest.approx(0.85)


def test_check_repeats_with_a_seed(built):
    first, second = (run("model", "check", built[0], "--json", "--seed", 3) for _ in range(2))
    assert first.exit_code == 0
    one, two = json.loads(first.stdout), json.loads(second.stdout)
    assert one["surface_error_mm"] == two["surface_error_mm"]
    shown = run("model", "check", built[0]).stdout
    assert "spline fit error" in shown
    size_mb = built[0].stat().st_size / 1e6
    assert one["file_megabytes"] == size_mb
    assert f"{size_mb:.1f} MB on disk" in shown


@pytest.mark.parametrize(("ending", "within_mm"), [("vtp", 1e-9), ("stl", 1e-5)])
def test_export_puts_every_phase_at_its_place(built, beating_sphere, tmp_path, ending, within_mm):
    """Read without our readers: the vertices of each phase are those that the model was built from."""
    result = run("model", "export", built[0], "-o", tmp_path / "out", "--format", ending, "--json")
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert (report["frame"], report["space"], len(report["files"])) == ("mr", "LPS", 3)
    for name, vertices in zip(report["files"], beating_sphere.vertices_mm, strict=True):
        data = (tmp_path / "out" / name).read_bytes()
        places = vtp_points(data) if ending == "vtp" else stl_points(data)
        for axis in range(3):
            found, known = np.unique(places[:, axis]), np.sort(vertices[:, axis])
            assert np.abs(found - known[0]).min() < within_mm
            assert np.abs(found - known[-1]).min() < within_mm
        distances, _ = KDTree(vertices).query(places)
        assert np.max(distances) < within_mm


def test_the_exported_distance_is_zero_on_the_exported_surface(built, tmp_path):
    """Sampled by SimpleITK: within the fit's error and that of linear interpolation, h²/4R."""
    for form in ("vtp", "nrrd"):
        assert run("model", "export", built[0], "-o", tmp_path, "--format", form).exit_code == 0
    for phase in range(3):
        image = SimpleITK.ReadImage(str(tmp_path / f"EPICARDIAL_distance_{phase:03d}.nrrd"))
        places = vtp_points((tmp_path / f"EPICARDIAL_{phase:03d}.vtp").read_bytes())[::7]
        found = [image.EvaluateAtPhysicalPoint(place, SimpleITK.sitkLinear) for place in places.tolist()]
        radius_mm = np.linalg.norm(places - places.mean(axis=0), axis=1).mean()
        assert np.abs(found).max() < image.GetSpacing()[0] ** 2 / (4 * radius_mm) + 0.03


def vtp_points(data):
    """(n, 3) points of a VTP file with inline base64, which must be tagged LPS."""
    root = ElementTree.fromstring(data)
    assert root.findtext(".//FieldData/Array[@Name='SPACE']", "").split() == ["76", "80", "83", "0"]
    return np.frombuffer(base64.b64decode(root.findtext(".//Points/DataArray", ""))[8:], "<f8").reshape(-1, 3)


def stl_points(data):
    """(3 n, 3) corners of a binary STL file, which must be tagged LPS."""
    assert b"SPACE=LPS" in data[:80]
    facets = np.frombuffer(
        data[84:], np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("", "<u2")])
    )
    return facets["corners"].reshape(-1, 3).astype(float)


def test_wanted_accuracy_sets_the_knots(built, tmp_path):
    folder, output = built[0].parent, tmp_path / "m.npz"
    result = run("model", "build", "--surfaces", folder, "-o", output, "--accuracy-mm", 0.02, "--json")
    report = json.loads(result.stdout)
    assert report["surface_error_mm"]["mean"] < 0.02
    assert report["knot_spacing_mm"] > built[1]["knot_spacing_mm"]
    assert report["megabytes"] < built[1]["megabytes"]
    assert report["normal_error_deg"]["p95"] < 5.0
    assert set(report["definitions"]) >= {"surface_error_mm", "normal_error_deg", "megabytes"}
    both = run("model", "build", "--surfaces", folder, "-o", output, "--accuracy-mm", 0.1, "--knot-mm", 3)
    assert both.exit_code == 2


def test_force_at_points(built, tmp_path):
    points = tmp_path / "points.csv"
    points.write_text("x_mm,y_mm,z_mm\n0,0,20\n500,0,0\n\n", encoding="utf-8")
    result = run("force", built[0], "--points", points, "--phase", 0.0, "--json")
    answer = json.loads(result.stdout)
    assert answer["status"] == ["OK", "OUT_OF_VOLUME"]
    np.testing.assert_allclose(answer["force_n"], [[0, 0, 0.3], [0, 0, 0]], atol=0.01)
    assert answer["distance_mm"][0] == pytest.approx(0.0, abs=0.03)
    assert answer["distance_mm"][1] is None
    assert "OUT_OF_VOLUME" in run("force", built[0], "--points", points, "--phase", 0.0).stdout


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "no rows of numbers"),
        ("1,2\n", "2 columns"),
        ("1,2,3\na,b,c\n", "line 2"),
        (None, "does not exist"),
    ],
)
def test_bad_points_exit_3_with_one_sentence(built, tmp_path, text, complaint):
    points = tmp_path / "points.csv"
    if text is not None:
        points.write_text(text, encoding="utf-8")
    result = run("force", built[0], "--points", points, "--phase", 0.0)
    assert result.exit_code == 3
    assert complaint in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_a_law_beyond_the_device_exits_3(built, tmp_path):
    points = tmp_path / "points.csv"
    points.write_text("0,0,0\n", encoding="utf-8")
    result = run("force", built[0], "--points", points, "--phase", 0.0, "--gamma", 5.0)
    assert result.exit_code == 3
    assert "750 N/m" in result.stderr


def test_build_from_labels(tmp_path):
    grid = Grid.axis_aligned("mr", (26, 26, 26), [-25.0] * 3, 2.0)
    radius = np.linalg.norm(grid.centers_mm(), axis=-1)
    values = np.stack([radius < 18, radius < 15]).astype(np.uint8)
    write_volume_series(VolumeSeries(grid, values, CycleTiming.uniform(2, 0.9)), tmp_path / "p7.nrrd")
    output = tmp_path / "model.npz"
    result = run("model", "build", "--labels", tmp_path / "p7.nrrd", "--organ", "1", "-o", output, "--json")
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["patient_id"] == "p7"
    assert report["surface_error_mm"]["mean"] < 0.05
    missing = run("model", "build", "--labels", tmp_path / "p7.nrrd", "--organ", "9", "-o", output)
    assert missing.exit_code == 3
    assert "organ labels [9]" in missing.stderr


def test_usage_errors_exit_2_and_unwritable_places_4(built, tmp_path):
    assert run("model", "build", "-o", tmp_path / "m.npz").exit_code == 2
    series = tmp_path / "labels.nrrd"
    assert run("model", "build", "--labels", series, "-o", tmp_path / "m.npz").exit_code == 2
    assert (
        run("model", "build", "--labels", series, "--organ", "1,a", "-o", tmp_path / "m.npz").exit_code == 2
    )
    nowhere = run("model", "build", "--surfaces", built[0].parent, "-o", tmp_path / "no" / "m.npz")
    assert nowhere.exit_code == 4
    assert not (tmp_path / "no").exists()


def test_one_mesh_file_makes_a_structure_that_does_not_beat(sphere_of, tmp_path):
    write_mesh(Mesh("mr", *sphere_of(14.0, 3)), tmp_path / "oesophagus.stl")
    out = tmp_path / "oesophagus.npz"
    result = run(
        *(
            "model",
            "build",
            "--surfaces",
            tmp_path / "oesophagus.stl",
            "--patient",
            "ball",
            "-o",
            out,
            "--json",
        )
    )
    assert result.exit_code == 0, result.output
    assert "assumed" not in result.stderr
    assert json.loads(result.stdout)["surface_error_mm"]["mean"] < 0.05
    model = read_model(out)
    assert (model.patient_id, model.surface_name, model.still) == ("ball", "oesophagus", True)


def test_labels_of_one_phase_make_a_structure_that_does_not_beat(tmp_path):
    grid = Grid.axis_aligned("mr", (26, 26, 26), [-25.0] * 3, 2.0)
    radius = np.linalg.norm(grid.centers_mm(), axis=-1)
    values = np.where(radius < 15, 5, np.where(radius < 20, 1, 0)).astype(np.uint8)
    write_volume(Volume(grid, values), tmp_path / "labels.nrrd")
    out = tmp_path / "nerve.npz"
    result = run("model", "build", "--labels", tmp_path / "labels.nrrd", "--organ", "5", "-o", out, "--json")
    assert result.exit_code == 0, result.output
    assert "nerve does not beat" in result.stderr
    model = read_model(out)
    assert (model.patient_id, model.surface_name, model.still) == ("labels", "nerve", True)
    assert np.linalg.norm(model.reference[1].vertices_mm, axis=1).mean() == pytest.approx(15.0, abs=0.2)
