"""The training figure: convergence against iterations and time; the exact solution is a line at its time."""

import numpy as np
import pytest
from drawn_lines import x_of, y_of

from dvf_ig.report.study.training import EXACT, FLOOR, TrainingCurve, training_figure


def test_curves_are_the_excess_cost() -> None:
    steps, seconds = np.array([1.0, 2.0, 4.0]), np.array([0.1, 0.2, 0.4])
    descent = TrainingCurve("gradient descent", 3, steps, seconds, np.array([1.0, 0.1, 0.0]))
    exact = TrainingCurve(EXACT, 3, np.ones(1), np.array([0.05]), np.zeros(1))
    by_iteration, by_time = training_figure([descent, exact], "toy").axes
    assert x_of(by_iteration.lines[0]).tolist() == [1.0, 2.0, 4.0]
    assert x_of(by_time.lines[0]).tolist() == [0.1, 0.2, 0.4]
    assert y_of(by_time.lines[0]) == pytest.approx([1.0, 0.1, FLOOR])
    assert x_of(by_time.lines[1])[0] == 0.05
    assert by_time.lines[0].get_color() == by_time.lines[1].get_color(), "one colour a degree"
