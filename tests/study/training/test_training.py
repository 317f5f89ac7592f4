"""Training study: every method reaches the exact minimum, gradient descent by far the slowest."""

import json
from itertools import count

import numpy as np
import pytest
from drawn_lines import x_of, y_of
from toy_sphere import sphere
from typer.testing import CliRunner

from dvf_ig.cli.main import app
from dvf_ig.core import InvalidInputError, Mesh
from dvf_ig.study.training import study as training_study
from dvf_ig.study.training.study import (
    CONJUGATE,
    EXACT,
    FLOOR,
    GRADIENT,
    Samples,
    compare_training,
    summarise_training,
    training_figure,
    training_trial,
)

SETTINGS = {"degrees": [1, 2], "pitch_mm": 16.0, "max_iterations": 40}


@pytest.fixture(scope="module")
def samples():
    return Samples.of_surface(Mesh("mr", *sphere(20.0)), 10.0)


@pytest.fixture(scope="module")
def compared(samples):
    ticks = count()
    return compare_training(samples, [1, 2], max_iterations=4000, clock=lambda: float(next(ticks)))


@pytest.fixture(scope="module")
def line():
    return {"seed": 3, **training_trial(SETTINGS, 3)}


def test_samples_are_the_distance_of_the_surface(samples):
    radius = np.linalg.norm(np.stack(np.meshgrid(*samples.positions_mm, indexing="ij")), axis=0)
    near = np.abs(radius - 20.0) < 4.0
    np.testing.assert_allclose(samples.values_mm[near], (20.0 - radius)[near], atol=0.3)


def test_every_method_approaches_the_exact_minimum(compared):
    assert [c.degree for c in compared] == [1, 2]
    assert compared[1].condition > 10.0 * compared[0].condition
    for comparison in compared:
        gradient, conjugate, exact = comparison.trainings
        assert (gradient.method, conjugate.method, exact.method) == (GRADIENT, CONJUGATE, EXACT)
        assert exact.excess == 0.0
        assert conjugate.excess < 1e-9
        assert 0.0 <= gradient.excess < 0.01
        assert conjugate.iterations < gradient.iterations
    assert compared[0].trainings[0].excess < 1e-9


def test_cost_never_rises_and_conjugate_gradients_are_ahead(compared):
    for comparison in compared:
        gradient, conjugate, _ = (training.curve for training in comparison.trainings)
        assert (np.diff(gradient.excess) <= 1e-12).all()
        both = min(len(gradient.excess), len(conjugate.excess)) - 1
        assert (conjugate.excess[:both] <= gradient.excess[:both]).all()


def test_recording_is_not_part_of_the_time(compared):
    """The clock ticks once a question: between two records the training itself asks nothing."""
    seconds = compared[1].trainings[0].curve.seconds
    np.testing.assert_array_equal(seconds, 1.0 + np.arange(len(seconds)))


def test_a_trial_its_summary_and_its_picture(line):
    rows = summarise_training([line, {"seed": 4, "refused": "why"}])
    assert [(row["degree"], row["method"]) for row in rows] == [
        (degree, method) for degree in (1, 2) for method in (GRADIENT, CONJUGATE, EXACT)
    ]
    exact = rows[2]
    assert exact["iterations_to_1_percent"] == 0
    assert exact["seconds_to_1_percent"] == exact["seconds"]
    slow = rows[3]
    assert slow["iterations"] == 40
    assert slow["excess"] > 0.01
    assert slow["iterations_to_1_percent"] is None
    assert rows[3]["rms_mm"] > rows[4]["rms_mm"]
    drawn = training_figure(json.loads(json.dumps(line))["networks"], "toy")
    assert len(drawn.axes[1].lines) == 1 + 2 * 3


@pytest.mark.parametrize("degrees", [[], [0], [1, 6]])
def test_degrees_are_checked(samples, degrees):
    with pytest.raises(InvalidInputError, match="spline degrees are"):
        compare_training(samples, degrees, max_iterations=5)


def test_the_command_writes_its_files(tmp_path, monkeypatch):
    monkeypatch.setattr(training_study, "PITCH_MM", 16.0)
    monkeypatch.setattr(training_study, "MAX_ITERATIONS", 20)
    result = CliRunner().invoke(
        app, ["study", "training", "-o", str(tmp_path / "t"), "--degrees", "1", "--seeds", "2", "--json"]
    )
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary == json.loads((tmp_path / "t" / "summary.json").read_text(encoding="utf-8"))
    assert (summary["seed"], summary["seeds"], summary["refused"]) == (1, 2, 0)
    assert len((tmp_path / "t" / "trials.jsonl").read_text(encoding="utf-8").splitlines()) == 2
    assert (tmp_path / "t" / "training.png").stat().st_size > 10_000
    bad = CliRunner().invoke(app, ["study", "training", "-o", str(tmp_path / "u"), "--degrees", "one"])
    assert bad.exit_code == 2


def test_curves_are_the_excess_cost() -> None:
    descent = {"iteration": [1, 2, 4], "seconds": [0.1, 0.2, 0.4], "excess": [1.0, 0.1, 0.0]}
    exact = {"iteration": [1], "seconds": [0.05], "excess": [0.0]}
    trainings = [{"method": GRADIENT, "curve": descent}, {"method": EXACT, "curve": exact}]
    by_iteration, by_time = training_figure([{"degree": 3, "trainings": trainings}], "toy").axes
    assert x_of(by_iteration.lines[0]).tolist() == [1.0, 2.0, 4.0]
    assert x_of(by_time.lines[0]).tolist() == [0.1, 0.2, 0.4]
    assert y_of(by_time.lines[0]) == pytest.approx([1.0, 0.1, FLOOR])
    assert x_of(by_time.lines[1])[0] == 0.05
    assert by_time.lines[0].get_color() == by_time.lines[1].get_color(), "one colour a degree"
