"""Equations 10–11: the printed form jumps at every volume, the corrected one is continuous."""

import numpy as np
import pytest

from dvf_ig.core import DvfModel
from dvf_ig.guidance import Sigmoid
from scripts.paper_figures import force_over_time, over_time_figure
from scripts.paper_figures.over_time import ForceOverTime

POINT_MM = np.array([19.0, 0.0, 0.0])
STEPS = 2000


@pytest.fixture(scope="module")
def found(sphere_model: DvfModel) -> ForceOverTime:
    return force_over_time(sphere_model, POINT_MM, Sigmoid(1.0), cycles=2, steps=STEPS)


def static_n(radius_mm: float) -> float:
    return float(0.6 * Sigmoid(1.0).potential(np.array(radius_mm - 19.0)))


def test_the_corrected_form_passes_through_each_volumes_own_force(found: ForceOverTime) -> None:
    for t_s, radius in zip(found.volume_t_s, (20.0, 17.0, 18.5) * 2, strict=True):
        assert np.interp(t_s, found.t_s, found.corrected_n) == pytest.approx(static_n(radius), abs=0.01)


def test_the_printed_form_gives_the_next_volumes_force(found: ForceOverTime) -> None:
    for t_s, following in zip(found.volume_t_s, (17.0, 18.5, 20.0) * 2, strict=True):
        at = int(np.searchsorted(found.t_s, t_s - 1e-9))
        assert found.printed_n[at] == pytest.approx(static_n(following), abs=0.01)


def test_only_the_printed_form_jumps(found: ForceOverTime) -> None:
    """A step of the corrected form is at most the change between two volumes over the steps between them."""
    change = max(abs(static_n(a) - static_n(b)) for a, b in ((20.0, 17.0), (17.0, 18.5), (18.5, 20.0)))
    smooth = 1.2 * change / (0.3 * STEPS)
    assert np.abs(np.diff(found.corrected_n)).max() < smooth
    jumps = np.flatnonzero(np.abs(np.diff(found.printed_n)) > smooth)
    # every volume but the very first, which begins the record
    assert len(jumps) == len(found.volume_t_s) - 1
    assert found.t_s[jumps + 1] == pytest.approx(found.volume_t_s[1:], abs=1e-9)


def test_no_line_joins_what_jumps(found: ForceOverTime) -> None:
    upper, lower = over_time_figure(found).axes
    printed, corrected = (line.get_ydata() for line in lower.lines[:2])
    np.testing.assert_array_equal(corrected, found.corrected_n)
    np.testing.assert_array_equal(upper.lines[0].get_ydata(), found.distance_mm)
    assert np.isnan(printed).sum() == len(found.volume_t_s) - 1
    steps = np.abs(np.diff(printed))
    assert steps[np.isfinite(steps)].max() < 0.002
