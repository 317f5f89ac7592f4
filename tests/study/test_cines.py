"""The study of real cines, on one made of a cine whose motion is known."""

import json

import numpy as np
import pytest
import SimpleITK
from short_axis_toy import CAVITY, contracting_stack
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.study.cines import outline_distance_mm


@pytest.fixture
def data(tmp_path):
    image, labels = contracting_stack((1.0, 0.9, 0.8, 0.9))
    folder = tmp_path / "data" / "patient1"
    folder.mkdir(parents=True)
    as_acdc = np.where(labels == CAVITY, 3, 2 * labels).astype(np.uint8)
    frames = [SimpleITK.GetImageFromArray(v.T.astype(np.float32)) for v in image.values]
    SimpleITK.WriteImage(SimpleITK.JoinSeries(frames), str(folder / "cine_4d.nii.gz"))
    for name, phase in (("ed", 0), ("es", 2)):
        written = SimpleITK.GetImageFromArray(as_acdc[phase].T)
        SimpleITK.WriteImage(written, str(folder / f"{name}_labels.nii.gz"))
    (folder / "frames.json").write_text('{"ed_frame": 1, "es_frame": 3, "first_frame": 1}')
    return folder.parent


def test_a_cine_without_its_voxel_size_is_used_once_that_is_given(data, tmp_path):
    command = ["study", "cines", "--data", str(data), "-o", str(tmp_path / "out"), "--json"]
    refused = CliRunner().invoke(app, command)
    assert refused.exit_code == 3
    assert "--voxel-mm" in refused.output
    done = CliRunner().invoke(app, [*command, "--voxel-mm", "1.5,1.5,10"])
    assert done.exit_code == 0, done.output
    (patient,) = json.loads(done.stdout)["patients"]
    assert patient["spacing_given"]
    by_name = {s["structure"]: s for s in patient["structures"]}
    assert by_name["LV"]["dice"] > 0.9 > by_name["LV"]["dice_still"]
    assert by_name["LV"]["mean_mm"] < 1.5 < by_name["LV"]["mean_still_mm"]


def test_outlines_of_shifted_squares_are_as_far_apart_as_the_shift_says():
    a = np.zeros((20, 20, 1), dtype=bool)
    a[5:15, 5:15] = True
    assert outline_distance_mm(a, a, np.array([1.5, 1.5, 10.0])) == 0.0
    grown = np.zeros_like(a)
    grown[4:16, 4:16] = True
    assert outline_distance_mm(a, grown, np.array([2.0, 2.0, 10.0])) == pytest.approx(2.0, abs=0.1)
    assert outline_distance_mm(a, np.zeros_like(a), np.ones(3)) is None
