"""`dvf-ig force`: confinement, free zone and passivity as a user types them."""

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from dvf_ig.cli.force import force
from dvf_ig.io import write_model

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


def test_a_free_zone_is_felt_at_its_border_only(run):
    result = run("--law", "gaussian", "--free-zone-mm", 2.0, "--felt-below-n", 0.05)
    np.testing.assert_allclose(outward(result), [-0.05, 0.0, 0.05], atol=0.005)
    assert "the free zone gives --delta-mm" in result.stderr


def test_a_law_that_is_not_passive_exits_3(run):
    result = run("--gamma", 1.0, "--device-damping", 0.05)
    assert result.exit_code == 3
    assert "150 N/m at its steepest, at most 100 N/m allowed by passivity at 1000 Hz (b 0.05" in result.stderr


@pytest.mark.parametrize("options", [("--law", "gaussian", "--inside"), ("--free-zone-mm", 1.0)])
def test_options_of_the_other_law_are_usage_errors(run, options):
    assert run(*options).exit_code == 2
