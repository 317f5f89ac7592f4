"""Retiming of one beat: identity where uniform, continuous, and a slope that is its derivative."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import InvalidInputError, RetimingCurve

PHI = np.linspace(0.0, 0.999, 500)


def test_uniform_is_the_identity() -> None:
    uniform = RetimingCurve.uniform()
    np.testing.assert_allclose(uniform.at(PHI), PHI, atol=1e-15)
    np.testing.assert_allclose(uniform.slope(PHI), 1.0, atol=1e-12)


@given(st.floats(0.2, 0.7), st.floats(0.2, 0.7), st.floats(0.0, 1.5), st.floats(0.0, 1.5))
def test_it_goes_through_its_knots_with_its_slopes(
    systole: float, model_es: float, at_r: float, at_es: float
) -> None:
    curve = RetimingCurve(systole, model_es, at_r, at_es)
    assert float(curve.at(0.0)) == 0.0
    assert float(curve.at(systole)) == pytest.approx(model_es)
    assert float(curve.at(np.nextafter(1.0, 0.0))) == pytest.approx(1.0)
    assert float(curve.slope(0.0)) == pytest.approx(at_r)
    assert float(curve.slope(systole)) == pytest.approx(at_es)
    assert float(curve.slope(np.nextafter(1.0, 0.0))) == pytest.approx(at_r)


def test_the_slope_is_the_derivative() -> None:
    curve = RetimingCurve(0.45, 0.35, 0.9, 1.1)
    inner = PHI[1:][np.abs(PHI[1:] - 0.45) > 1e-3]
    difference = (curve.at(inner + 1e-7) - curve.at(inner - 1e-7)) / 2e-7
    np.testing.assert_allclose(curve.slope(inner), difference, atol=1e-6)


def test_phase_is_taken_modulo_one() -> None:
    curve = RetimingCurve(0.45, 0.35, 0.9, 1.1)
    np.testing.assert_allclose(curve.at(PHI + 3.0), curve.at(PHI), atol=1e-12)


def test_refusals() -> None:
    with pytest.raises(InvalidInputError, match="between 0 and 1"):
        RetimingCurve(0.0, 0.3, 1.0, 1.0)
    with pytest.raises(InvalidInputError, match="0 or above"):
        RetimingCurve(0.4, 0.3, -1.0, 1.0)
    with pytest.raises(InvalidInputError, match="between 0 and 1"):
        RetimingCurve(float("nan"), 0.3, 1.0, 1.0)
