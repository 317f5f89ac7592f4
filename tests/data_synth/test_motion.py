"""The closed-form heart motion: incompressible wall, named amplitudes, exact inverse."""

import numpy as np
import pytest

from data_synth.kernels import lv
from data_synth.motion import ES_FRACTION, activation, preset_scale
from dvf_ig.core import FloatArray, InvalidInputError


def forward(points: FloatArray, level: float) -> FloatArray:
    out = np.empty_like(points)
    lv.forward(points, np.full(len(points), level), out)
    return out


def jacobian_determinant(points: FloatArray, level: float) -> FloatArray:
    h = 1e-5
    columns = [(forward(points + h * e, level) - forward(points - h * e, level)) / (2 * h) for e in np.eye(3)]
    return np.linalg.det(np.stack(columns, axis=-1))


def ring(height: FloatArray, radius: FloatArray, angle: FloatArray) -> FloatArray:
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


@pytest.fixture(scope="module")
def wall() -> FloatArray:
    """Random points of the left-ventricular wall, away from its two surfaces and the pointed apex."""
    rng = np.random.default_rng(0)
    z = rng.uniform(2.0, 84.0, 4000)
    outer, inner = np.array([lv.radii(h) for h in z]).T
    return ring(z, inner + (outer - inner) * rng.uniform(0.02, 0.98, 4000), rng.uniform(0, 2 * np.pi, 4000))


@pytest.mark.parametrize("level", [0.1, 0.35, 1.0])
def test_wall_is_incompressible(wall: FloatArray, level: float) -> None:
    assert np.abs(jacobian_determinant(wall, level) - 1).max() < 1e-5


@pytest.mark.parametrize("level", [0.35, 1.0])
def test_whole_space_is_invertible(level: float) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-110, -110, -60], [110, 110, 190], (40_000, 3))
    assert jacobian_determinant(points, level).min() > 0.2
    found = np.empty_like(points)
    lv.inverse(points, np.full(len(points), level), points.copy(), found)
    assert np.linalg.norm(forward(found, level) - points, axis=1).max() < 1e-3


@pytest.mark.parametrize(("motion", "largest_mm"), [("physiological", 13.9), ("paper5mm", 4.96)])
def test_named_motions_have_their_epicardial_amplitude(motion: str, largest_mm: float) -> None:
    z, angle = (g.ravel() for g in np.meshgrid(np.linspace(0, lv.BASE, 200), np.linspace(0, 2 * np.pi, 60)))
    epicardium = ring(z, np.array([lv.radii(h)[0] for h in z]), angle)
    moved = np.linalg.norm(forward(epicardium, preset_scale(motion)) - epicardium, axis=1)
    assert moved.max() == pytest.approx(largest_mm, abs=0.03)


def test_ejection_fraction_of_the_closed_form() -> None:
    z = np.linspace(lv.CAVITY_APEX, lv.BASE, 2000)
    inner = np.array([lv.radii(h)[1] for h in z])
    rim = forward(ring(z, inner, np.zeros_like(z)), 1.0)
    radius = np.hypot(rim[:, 0], rim[:, 1])
    filled, emptied = np.trapezoid(inner**2, z), np.trapezoid(radius**2, rim[:, 2])
    assert 1 - emptied / filled == pytest.approx(0.64, abs=0.005)


def test_motion_is_continuous_across_every_seam() -> None:
    """Endocardium, epicardium, cavity apex, apex and base: no jump larger than the step taken across."""
    rng = np.random.default_rng(2)
    z, angle = rng.uniform(5, 120, 2000), rng.uniform(0, 2 * np.pi, 2000)
    outer, inner = np.array([lv.radii(h) for h in z]).T
    step = 1e-6
    for radius in (outer, inner):
        gap = forward(ring(z, radius + step, angle), 1.0) - forward(ring(z, radius - step, angle), 1.0)
        assert np.linalg.norm(gap, axis=1).max() < 1e-4
    for height in (0.0, lv.CAVITY_APEX, lv.BASE):
        radius = rng.uniform(0.5, 80, 2000)
        low = forward(ring(np.full(2000, height - step), radius, angle), 1.0)
        high = forward(ring(np.full(2000, height + step), radius, angle), 1.0)
        # the pointed apex has an infinite slope in R_o(Z): there the gap shrinks with the root of the step
        assert np.linalg.norm(high - low, axis=1).max() < (2e-2 if height == 0.0 else 1e-4)


def test_activation_is_periodic_smooth_and_peaks_at_end_systole() -> None:
    phase = np.linspace(0, 1, 2001)
    level = activation(phase)
    assert activation(0.0) == pytest.approx(activation(1.0), abs=1e-12)
    assert phase[level.argmax()] == pytest.approx(ES_FRACTION, abs=1e-3)
    assert level.min() >= 0
    assert level.max() == pytest.approx(1.0)
    slope = np.diff(level) / np.diff(phase)
    assert abs(slope[0] - slope[-1]) < 0.05


def test_unknown_motion_lists_the_choices() -> None:
    with pytest.raises(InvalidInputError, match="paper5mm"):
        preset_scale("fast")
