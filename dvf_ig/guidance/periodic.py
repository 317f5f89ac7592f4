"""Signed distance as a cubic periodic spline of phase through all phases of the model.

d(q, φ) = Σ_j N_j(φ) b_j(q), with N_j the cubic B-splines on the phase times continued around the cycle. The
fields b_j are splines in space on the model's own knots, so interpolation at the phase times is one small
cyclic system, the same for every coefficient. d is then C² in phase, and ∂d/∂φ is available.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from dvf_ig.core import CycleTiming, FloatArray

DEGREE = 3
SUPPORT = DEGREE + 1
"""Intervals in the support of one cubic B-spline, and B-splines that are not zero on one interval."""


def periodic_powers(timing: CycleTiming) -> FloatArray:
    """(n, 4, 4) per interval, the coefficients of 1, α, α², α³ in the B-splines centred on phases i−1 … i+2.

    α in [0, 1] is the position between phase i and the next. The support of phase j's B-spline is j−2 to j+2.
    """
    count = len(timing)
    powers = np.empty((count, SUPPORT, SUPPORT))
    for i in range(count):
        start = _time(timing, i)
        width = _time(timing, i + 1) - start
        for m in range(SUPPORT):
            knots = np.array([_time(timing, i - 1 + m + offset) for offset in (-2, -1, 0, 1, 2)])
            basis = BSpline.basis_element(knots, extrapolate=False)
            factor = 1.0
            for power in range(SUPPORT):
                powers[i, power, m] = float(basis(start, nu=power)) * width**power / factor
                factor *= power + 1
    return powers


def periodic_coefficients(coefficients: NDArray[np.float32], timing: CycleTiming) -> NDArray[np.float32]:
    """(n, …) coefficients of the b_j from those of the n phases."""
    count = len(timing)
    values = periodic_powers(timing)[:, 0, :]
    system = np.zeros((count, count))
    for i in range(count):
        for m in range(SUPPORT):
            system[i, (i - 1 + m) % count] += values[i, m]
    solved = np.linalg.solve(system, coefficients.reshape(count, -1).astype(np.float64))
    return np.ascontiguousarray(solved.reshape(coefficients.shape), dtype=np.float32)


def _time(timing: CycleTiming, k: int) -> float:
    """Time of phase `k` in cycles, continued before and after the cycle."""
    cycles, phase = divmod(k, len(timing))
    return cycles + float(timing.fractions[phase])
