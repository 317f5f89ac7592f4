"""The blending figure draws mean and 95th percentile of each blend, in the units of its axes."""

import pytest
from drawn_lines import y_of

from dvf_ig.report.study.blending import blending_figure, blending_png
from dvf_ig.study.blending.blend_errors import BlendError, BlendStudy


def study() -> BlendStudy:
    errors = tuple(
        BlendError("calm", blend, n, 1 / n, 2 / n, 3 / n, 0.1 / n, 0.2 / n, 0.3 / n, 0.5 / n, 0.6 / n)
        for blend in ("force", "distance")
        for n in (5, 10)
    )
    at = BlendError("calm", "distance", 10, 0.01, 0.02, 0.03, 0.001, 0.002, 0.003, None, None)
    return BlendStudy("calm", errors, at, 5.0)


def test_curves_are_the_errors() -> None:
    own, surface, force = blending_figure([study()]).axes
    assert y_of(own.lines[0]) == pytest.approx([0.1, 0.05])
    assert y_of(surface.lines[1]) == pytest.approx([0.4, 0.2])
    assert y_of(force.lines[0]) == pytest.approx([20.0, 10.0]), "mN"
    assert [len(axis.lines) for axis in (own, surface, force)] == [4, 5, 5], "a floor where there is one"
    assert blending_png([study()]).startswith(b"\x89PNG")
