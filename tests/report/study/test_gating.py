"""The risk–coverage figure: curves in percent, a dot where the clock locks, none where it never does."""

import math

import numpy as np
from drawn_lines import x_of, y_of

from dvf_ig.report.study.gating import RiskCoverage, risk_coverage_figure


def test_curves_and_dots() -> None:
    share, p95 = np.array([0.1, 0.5, 1.0]), np.array([1.0, 2.0, 9.0])
    rhythms = [
        RiskCoverage("sinus", share, p95, 0.9, 3.0),
        RiskCoverage("fibrillation", share, 2 * p95, 0.0, math.nan),
    ]
    lines = risk_coverage_figure(rhythms).axes[0].lines
    curve, dot, target, other = lines
    assert x_of(curve).tolist() == [10.0, 50.0, 100.0]
    assert y_of(curve).tolist() == [1.0, 2.0, 9.0]
    assert (x_of(dot)[0], y_of(dot)[0]) == (90.0, 3.0)
    assert y_of(target)[0] == 8.0
    assert y_of(other).tolist() == [2.0, 4.0, 18.0]
