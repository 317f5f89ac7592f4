"""`dvf-ig force`: confinement, free zone and passivity as a user types them."""

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from dvf_ig.cli.force import force
from dvf_ig.io import write_model


def plain(text):
    """A usage error without the frame around it and its line breaks."""
    return " ".join(text.replace("│", " ").split())


app = typer.Typer()
app.command("force")(force)


@pytest.fixture
def run(ball, tmp_path):
    """`force` on the ball at its first phase, 2 mm outside, on, and 2 mm inside its surface."""
    write_model(ball, tmp_path / "ball.npz")
    points = tmp_path / "points.csv"
    points.write_text("0,0,18\n0,0,16\n0,0,14\n", encoding="utf-8")

    def invoke(*options):
        head = [str(tmp_path / "ball.npz"), "--points", str(points), "--phase", "0.05", "--json"]
        return CliRunner().invoke(app, [*head, *map(str, options)])

    return invoke


def outward(result):
    assert result.exit_code == 0, result.output
    return np.array(json.loads(result.stdout)["force_n"])[:, 2]


def test_inside_confines(run):
    logistic = 0.6 / (1 + np.exp(2.0 * np.array([2.0, 0.0, -2.0])))
    np.testing.assert_allclose(outward(run("--gamma", 2.0)), logistic, atol=0.006)
    np.testing.assert_allclose(outward(run("--gamma", 2.0, "--inside")), logistic - 0.6, atol=0.006)


def test_a_margin_begins_a_wall_earlier(run):
    for options in (("--margin", 1.5), ("--margin", "adaptive", "--sigma-mm", 1.5 / 1.6448536)):
        result = run(*options)
        np.testing.assert_allclose(outward(result), outward(run("--depth-mm", -1.5)), atol=1e-7)
        assert json.loads(result.stdout)["margin_mm"] == pytest.approx(1.5)
    np.testing.assert_allclose(outward(run("--margin", "fixed")), outward(run("--depth-mm", -2.0)))
    np.testing.assert_array_equal(outward(run("--margin", "off")), outward(run()))
    assert "needs --sigma-mm" in plain(run("--margin", "adaptive").stderr)
    assert run("--margin", "wide").exit_code == 3


def test_a_free_zone_is_felt_at_its_border_only(run):
    result = run("--law", "guidance", "--free-zone-mm", 2.0, "--felt-below-n", 0.05)
    np.testing.assert_allclose(outward(result), [-0.05, 0.0, 0.05], atol=0.005)
    assert "the free zone gives --delta" in result.stderr
    said = dict(zip(*[iter(result.stderr.split("gives ")[1].split())] * 2, strict=True))
    again = run("--law", "guidance", *(word for pair in said.items() for word in pair))
    np.testing.assert_allclose(outward(again), outward(result), atol=1e-3)


def test_a_force_that_no_device_is_named_for_exits_3(run, tmp_path):
    """`--cap-n 1000 --gamma 0.001` gave 490 N at 21 mm outside the organ."""
    assert "1000 N; no device holds more than 20 N" in plain(run("--cap-n", 1000, "--gamma", 0.001).stderr)
    for options, complaint in (
        (
            ("--cap-n", 4.1),
            "force cap cap_n is 4.1 N; at most 4 N is allowed where no stronger device is named",
        ),
        (("--gamma", 0.001), "1% of the force would be felt 4595 mm from the organ's surface"),
        (("--gamma", 0.25, "--margin", 5), "and a margin of 5 mm 1% of the force would be felt 23.38 mm"),
        (("--depth-mm", -200), "use a larger depth_mm"),
    ):
        result = run(*options)
        assert result.exit_code == 3
        assert complaint in plain(result.stderr)
    file = tmp_path / "fixtures.yaml"
    device = "device: {name: omega.3, continuous_force_n: 12, stiffness_n_per_m: 3000}\n"
    file.write_text(device + "fixtures: [{law: forbidden, cap_n: 12.0}]\n", encoding="utf-8")
    np.testing.assert_allclose(outward(run("--fixtures", file))[1], 6.0, atol=0.1)
    file.write_text(device + "fixtures: [{law: forbidden, cap_n: 12.5}]\n", encoding="utf-8")
    assert "the omega.3 holds 12 N for long; lower it" in plain(run("--fixtures", file).stderr)
    file.write_text("device: {continuous_force_n: 12}\nfixtures: [{law: forbidden}]\n", encoding="utf-8")
    assert "device.name: it is missing" in plain(run("--fixtures", file).stderr)


def test_the_output_says_how_far_each_fixture_is_felt(run, tmp_path):
    assert json.loads(run().stdout)["reach_mm"] == [pytest.approx(4.595, abs=1e-3)]
    assert json.loads(run("--margin", 2, "--gamma", 2).stdout)["reach_mm"] == [pytest.approx(4.298, abs=1e-3)]
    assert json.loads(run("--law", "guidance").stdout)["reach_mm"] == [None]
    head = [str(tmp_path / "ball.npz"), "--points", str(tmp_path / "points.csv"), "--phase", "0.05"]
    said = [
        CliRunner().invoke(app, [*head, *options]).stderr
        for options in ([], ["--inside"], ["--depth-mm", "6"], ["--law", "guidance"])
    ]
    assert "the fixture is felt (1 % of 0.6 N) from 4.6 mm outside the surface" in said[0]
    assert "felt (1 % of 0.6 N) from 4.6 mm inside the surface" in said[1]
    assert "felt (1 % of 0.6 N) from 1.4 mm inside the surface" in said[2]
    assert "the fixture pulls from everywhere, by at most 0.6 N" in said[3]


def test_a_law_that_is_not_passive_exits_3(run):
    result = run("--gamma", 1.0, "--device-damping", 0.05)
    assert result.exit_code == 3
    assert "150 N/m at its steepest, at most 100 N/m allowed by passivity at 1000 Hz (b 0.05" in result.stderr


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--law", "guidance", "--inside"), "--law guidance does not take --inside; it takes --delta, --m"),
        (("--delta", 2.0), "--law forbidden does not take --delta; it takes --gamma, --cap-n"),
        (("--law", "guidance", "--gamma", 2.0), "--law guidance does not take --gamma"),
        (("--free-zone-mm", 1.0), "--free-zone-mm belongs to --law guidance"),
        (("--law", "guidance", "--delta", 2.0, "--free-zone-mm", 1.0), "chooses its --delta and --m"),
        (("--law", "sigmoid"), "sigmoid is now called forbidden"),
        (("--law=gaussian",), "gaussian is now called guidance"),
        (("--law", "path"), "describe it in a file and give that with --fixtures"),
        (("--law", "cubic"), "'cubic' is not a law; needed forbidden or guidance"),
        (("--delta-mm", 2.0), "No such option: --delta-mm"),
        (("--blend", "nearest"), "'nearest' is not one of"),
    ],
)
def test_options_that_do_not_fit_are_usage_errors(run, options, complaint):
    done = run(*options)
    assert done.exit_code == 2
    assert complaint in plain(done.stderr)


def test_a_former_option_says_the_new_one(run):
    assert "--delta" in plain(run("--delta-mm", 2.0).stderr).replace("--delta-mm", "")


def test_guidance_pulls_from_both_sides(run):
    pull = 0.5 * -np.expm1(-((2.0 / 4.0) ** 4))
    options = ("--law", "guidance", "--delta", 4.0, "--m", 2.0, "--cap-n", 0.5)
    np.testing.assert_allclose(outward(run(*options)), [-pull, 0.0, pull], atol=0.005)
    deeper = outward(run(*options, "--depth-mm", 2.0))
    assert deeper[2] == pytest.approx(0.0, abs=0.005)
    assert deeper[1] == pytest.approx(-pull, abs=0.005)


def test_several_fixtures_from_a_file(run, tmp_path):
    """Above the ball's top a path pulls to the side, and the forbidden surface pushes out first."""
    file = tmp_path / "fixtures.yaml"
    file.write_text(
        "cap_n: 0.5\nretiming: uniform\nfixtures:\n"
        "  - {law: forbidden, name: ball}\n"
        "  - {law: path, delta: 4.0, path: [[5, -50, 16], [5, 50, 16]]}\n",
        encoding="utf-8",
    )
    result = run("--fixtures", file)
    assert result.exit_code == 0, result.output
    force_n = np.array(json.loads(result.stdout)["force_n"])
    np.testing.assert_allclose(force_n[1], [0.2, 0.0, 0.3], atol=0.01)
    np.testing.assert_allclose(json.loads(result.stdout)["distance_mm"], [-2.0, 0.0, 2.0], atol=0.02)


def test_a_file_of_fixtures_excludes_the_options_of_one(run, tmp_path):
    file = tmp_path / "fixtures.yaml"
    file.write_text("fixtures: [{law: forbidden}]\n", encoding="utf-8")
    done = run("--fixtures", file, "--law", "guidance", "--cap-n", 0.5, "--inside")
    assert done.exit_code == 2
    assert "--fixtures describes every fixture; leave out --law, --cap-n, --inside" in plain(done.stderr)
    assert run("--fixtures", file, "--free-zone-mm", 1.0).exit_code == 2


def test_a_faulty_file_is_one_sentence(run, tmp_path):
    file = tmp_path / "fixtures.yaml"
    file.write_text("fixtures: [{law: forbidden, gama: 1.0}]\n", encoding="utf-8")
    done = run("--fixtures", file)
    assert done.exit_code == 3
    assert f"error: {file}: fixtures.0: unknown key gama; needed some of" in done.stderr
