"""The covariance of a pose in words: the least-constrained direction is the one that was put in."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import HEART_RADIUS_MM, InvalidInputError
from dvf_ig.registration import least_constrained_direction

SMALL = np.diag([(0.3 / HEART_RADIUS_MM) ** 2] * 3 + [0.3**2] * 3)


def with_sigma(turn: list[float], shift: list[float], sigma_mm: float) -> np.ndarray:
    """Covariance with `sigma_mm` along a unit (turn · radius, shift) on top of 0.3 mm everywhere."""
    worst = np.array([*np.array(turn) / HEART_RADIUS_MM, *shift])
    return SMALL + (sigma_mm**2 - 0.3**2) * np.outer(worst, worst)


def test_a_rotation_is_named() -> None:
    found = least_constrained_direction(with_sigma([0.0, 0.6, -0.8], [0, 0, 0], 1.8))
    assert found.turning
    assert found.sigma_mm == pytest.approx(1.8)
    assert found.turn_share == pytest.approx(1.0)
    np.testing.assert_allclose(found.axis, [0.0, -0.6, 0.8], atol=1e-9)
    assert found.sentence() == (
        "weakest: 1.8 mm by turning about (0.0, -0.6, 0.8); add views whose plane lies across that axis"
    )


def test_a_translation_is_named_after_its_axis() -> None:
    found = least_constrained_direction(with_sigma([0, 0, 0], [0.0, 0.0, -1.0], 2.25))
    assert not found.turning
    assert found.turn_share == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(found.axis, [0, 0, 1], atol=1e-9)
    assert found.sentence().startswith("weakest: 2.2 mm along (0.0, 0.0, 1.0), head–foot; add views")


@given(st.lists(st.floats(-1, 1), min_size=36, max_size=36), st.floats(0.1, 10))
def test_scale_and_bound(entries: list[float], scale: float) -> None:
    """Doubling every error doubles sigma; sigma is at least any coordinate's own."""
    root = np.diag([1 / HEART_RADIUS_MM] * 3 + [1.0] * 3) @ np.array(entries).reshape(6, 6)
    covariance = root @ root.T + SMALL
    found, larger = (
        least_constrained_direction(covariance),
        least_constrained_direction(scale**2 * covariance),
    )
    assert larger.sigma_mm == pytest.approx(scale * found.sigma_mm, rel=1e-6)
    own = np.sqrt(np.diag(covariance)) * ([HEART_RADIUS_MM] * 3 + [1.0] * 3)
    assert found.sigma_mm >= own.max() - 1e-9
    assert np.linalg.norm(found.axis) == pytest.approx(1.0)


def test_an_open_direction_says_so() -> None:
    found = least_constrained_direction(np.full((6, 6), np.nan))
    assert found.sigma_mm == float("inf")
    assert "leave the pose open" in found.sentence()


def test_what_is_no_covariance_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"shape \(3, 3\); needed \(6, 6\)"):
        least_constrained_direction(np.eye(3))
    with pytest.raises(InvalidInputError, match="variance of -1"):
        least_constrained_direction(np.diag([1.0, 1, 1, 1, 1, -1]))
