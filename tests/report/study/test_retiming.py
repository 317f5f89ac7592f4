"""The retiming figure: curves and bands are hearts that do not obey the assumed law."""

import numpy as np
import pytest
from drawn_lines import x_of, y_of

from dvf_ig.report.study.retiming import COLORS, retiming_figure
from dvf_ig.study.retiming.surface_error import METHODS, RetimingRow


def test_every_method_has_its_colour() -> None:
    assert tuple(COLORS) == METHODS


def test_curves_and_bands() -> None:
    rows = [
        RetimingRow(
            rate, slope, method, 0.0, 0.0 if slope == 0.002 else k + rate / 60 + 100 * slope, 0.0, 2 * k
        )
        for k, method in enumerate(METHODS)
        for rate in (60.0, 90.0)
        for slope in (0.0013, 0.002, 0.0027)
    ]
    left, right = retiming_figure(rows, model_rate_bpm=70.0, assumed_slope_s_per_bpm=0.002).axes
    assert [line.get_label() for line in left.lines[:3]] == list(METHODS)
    assert x_of(left.lines[1]) == pytest.approx([60.0, 90.0])
    assert y_of(left.lines[1]) == pytest.approx([2.2, 2.7])
    assert y_of(right.lines[2]) == pytest.approx([4.0, 4.0])
    band = np.asarray(left.collections[0].get_paths()[0].vertices)[:, 1]
    assert (band.min(), band.max()) == pytest.approx((1.13, 1.77))
