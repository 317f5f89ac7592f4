"""Margins compared on hearts whose errors and σ are drawn: what must win, tie and lose does."""

import numpy as np
import pytest

from dvf_ig.core import InvalidInputError
from dvf_ig.report.study.margins import margins_png
from dvf_ig.session.margins import SHAPE_SIGMA_MM, TIP_SIGMA_MM, TOOL_SIGMA_MM
from dvf_ig.study.margins.summary import summarise_margins, total_sigma_mm
from dvf_ig.study.margins.trial import trial_numbers
from dvf_ig.study.trials import Line

OTHERS_MM = float(np.linalg.norm([SHAPE_SIGMA_MM, TIP_SIGMA_MM, TOOL_SIGMA_MM]))


def value(number: float | None) -> float:
    """A figure that must be there."""
    assert number is not None
    return number


def lines(true_mm: np.ndarray, stated_mm: np.ndarray, seed: int = 0, count: int = 2000) -> list[Line]:
    """A recording of each heart: errors of σ `true_mm`, of which the session states `stated_mm`."""
    rng = np.random.default_rng(seed)
    made = []
    for heart, (true, stated) in enumerate(zip(true_mm, stated_mm, strict=True)):
        registration = np.sqrt(max(stated**2 - OTHERS_MM**2, 0.0))
        made.append(
            {
                "heart": heart,
                "preset": "calm",
                "times": 1,
                "error_mm": rng.normal(scale=true, size=count).tolist(),
                "registration_mm": [float(registration)] * count,
                "phase_mm": [0.0] * count,
                "ageing_mm": [0.0] * count,
            }
        )
    return made


def test_an_adaptive_margin_wins_where_the_session_knows_its_error() -> None:
    """Half of the hearts at 1 mm, half at 2.5 mm: at 95 % the wall of every heart stands as often inside."""
    sigma = np.array([1.0, 2.5] * 15)
    found = summarise_margins(lines(sigma, sigma))
    stated = found.stated
    assert (found.hearts, found.recordings, found.failed) == (30, 30, 0)
    assert stated.widening_mm == pytest.approx(1.645 * 1.75, abs=0.01)
    assert value(stated.fixed.p95_mm.value) == pytest.approx(1.645 * (2.5 - 1.75), abs=0.2)
    assert value(stated.adaptive.p95_mm.value) < 0.25
    assert stated.adaptive.share == pytest.approx(0.05, abs=0.005)
    assert value(stated.reduction.value) > 0.75
    assert value(stated.reduction.low) > 0.6
    assert found.z_rms == pytest.approx(1.0, abs=0.02)
    assert value(found.correlation) > 0.8
    assert value(found.off.p95_mm.value) == pytest.approx(1.645 * 2.5, abs=0.25)
    widths = [width.widening_mm for width in found.widths]
    assert widths == sorted(widths)
    assert margins_png(found).startswith(b"\x89PNG")


def test_a_margin_gains_nothing_from_sigma_that_has_nothing_to_do_with_the_error() -> None:
    """Errors alike, σ drawn: equal room, and a narrow margin where it is not deserved."""
    stated = np.random.default_rng(1).permutation(np.linspace(0.95, 2.5, 30))
    found = summarise_margins(lines(np.full(30, 2.2), stated))
    assert value(found.stated.reduction.value) < 0.0
    even = summarise_margins(lines(np.full(30, 2.2), np.ones(30)))
    assert value(even.stated.reduction.value) == pytest.approx(0.0, abs=1e-9)
    assert value(even.stated.fixed.mean_mm.value) == pytest.approx(value(even.stated.adaptive.mean_mm.value))


def test_sigma_is_the_session_s() -> None:
    (line,) = lines(np.ones(1), np.array([1.2]), count=3)
    np.testing.assert_allclose(total_sigma_mm(line), 1.2)
    with pytest.raises(InvalidInputError, match=r"look at trials\.jsonl"):
        summarise_margins([{"seed": 1, "refused": "no"}, {**line, "times": 0}])
    assert trial_numbers([1001, 1002], {"presets": ["calm", "poor-image"]}) == [2002, 2003, 2004, 2005]
