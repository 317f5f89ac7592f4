"""A stylus on a small beating ball: the fixture holds it to the surface, friction keeps it off."""

import numpy as np
import pytest
from drawn_lines import y_of

from data_synth.operator.contact import MovingSurface
from dvf_ig.core import CycleTiming, FloatArray, InvalidInputError, SurfaceSeries
from dvf_ig.guidance import DEVICES, DeviceLimits, SimulatedDevice
from dvf_ig.preop import ModelOptions, model_from_surfaces
from dvf_ig.study.tracking.study import tracking_figure
from dvf_ig.study.tracking.stylus import (
    BeatingSurface,
    held_styli,
    hold_stylus,
    pool_hearts,
    spare_friction_n,
    with_fixture,
)

CENTER = np.array([10.0, -5.0, 3.0])
PLACES = np.array([[0.6, 0.0, 0.8], [-0.48, 0.64, 0.6]])


def sphere(rows: int = 24, columns: int = 40) -> tuple[FloatArray, np.ndarray]:
    """Unit sphere of rings between two poles: vertices and outward triangles."""
    polar = np.linspace(0, np.pi, rows + 1)[1:-1]
    around = np.arange(columns) * 2 * np.pi / columns
    rings = [
        np.column_stack([np.sin(p) * np.cos(around), np.sin(p) * np.sin(around), np.full(columns, np.cos(p))])
        for p in polar
    ]
    vertices = np.concatenate([[[0, 0, 1.0]], *rings, [[0, 0, -1.0]]])
    last, triangles = len(vertices) - 1, []
    for k in range(columns):
        a, b = 1 + k, 1 + (k + 1) % columns
        triangles.append((0, a, b))
        for r in range(len(polar) - 1):
            u, v = a + r * columns, b + r * columns
            triangles += [(u, u + columns, v + columns), (u, v + columns, v)]
        triangles.append((last, b + (len(polar) - 1) * columns, a + (len(polar) - 1) * columns))
    return vertices, np.array(triangles)


class Ball:
    """Radius 22 mm, drawn back by up to 4 mm once a cycle."""

    def __init__(self) -> None:
        self.unit, self.surface_triangles = sphere()

    def surface_vertices(self, model_phase: float) -> FloatArray:
        return np.asarray(CENTER + self.unit * (22.0 - 4.0 * np.sin(np.pi * model_phase) ** 2))


@pytest.fixture(scope="module")
def ball() -> BeatingSurface:
    ball = Ball()
    timing = CycleTiming.uniform(12, 0.6)
    vertices = np.stack([ball.surface_vertices(phase) for phase in timing.fractions])
    series = SurfaceSeries("EPICARDIAL", "mr", vertices, ball.surface_triangles, timing, "ball")
    model = model_from_surfaces(series, options=ModelOptions(knot_spacing_mm=4.0, margin_mm=8.0))
    starts = CENTER + 22.0 * PLACES
    return BeatingSurface("paper5mm", MovingSurface.of(ball), model, starts, np.full(2, 4.0))


def test_a_light_device_is_held_to_the_surface(ball: BeatingSurface) -> None:
    run = hold_stylus(ball, with_fixture(DEVICES["premium"], "force", compensate=False), cycles=3)
    summary = run.summary()
    assert run.distance_mm.shape == (2, 1800)
    assert summary["mean_mm"] < 0.2
    assert summary["largest_force_n"] <= 0.6
    np.testing.assert_allclose(run.outward, PLACES, atol=0.05)


def test_distance_is_to_the_true_surface(ball: BeatingSurface) -> None:
    run = hold_stylus(ball, with_fixture(DEVICES["omni"], "distance", compensate=True), cycles=1)
    radius = 22.0 - 4.0 * np.sin(np.pi * run.t_s / 0.6) ** 2
    expected = radius - np.linalg.norm(run.tip_mm - CENTER, axis=2)
    # the faceted sphere lies up to 22 mm · (1 − cos 4.5°) inside the round one
    np.testing.assert_allclose(run.distance_mm, expected, atol=0.14)


def test_without_mass_the_error_is_the_dead_band_of_friction(ball: BeatingSurface) -> None:
    """A light, slow tool lags by just what it takes to overcome friction: δ[−ln(1−c/F)]^(1/2m)."""
    light = SimulatedDevice("light", 0.002, 0.2, 0.1)
    stylus = with_fixture(light, "distance", compensate=False)
    run = hold_stylus(ball, stylus, cycles=2)
    moving = np.abs(np.sin(2 * np.pi * run.t_s / 0.6)) > 0.5
    moving &= run.t_s > 0.6
    dead_band = stylus.law.half_width_mm(0.1)
    drag_mm = 0.2 * 0.021 / 0.4
    held = np.abs(run.distance_mm[:, moving]).mean(axis=1)
    np.testing.assert_allclose(held, dead_band + drag_mm, atol=0.06)


def test_feed_forward_overcomes_friction_and_stays_passive(ball: BeatingSurface) -> None:
    omni = DEVICES["omni"]
    plain, helped = (
        hold_stylus(ball, with_fixture(omni, "force", compensate=c), cycles=2).summary()
        for c in (False, True)
    )
    assert helped["mean_mm"] < 0.6 * plain["mean_mm"]
    used = spare_friction_n(omni)
    left = DeviceLimits(
        damping_n_s_per_m=0.005, friction_n=omni.dry_n - used, resolution_mm=0.055, fastest_mm_s=150.0
    )
    assert left.passive_stiffness_n_per_mm >= 0.4


def test_feed_forward_is_tried_where_friction_can_be_spared() -> None:
    tried = held_styli(list(DEVICES.values()), ["force", "distance"])
    assert [(f.device.name, f.feed_forward.friction_n > 0) for f in tried] == [
        ("PHANToM Premium 1.0", False), ("PHANToM Premium 1.0", False),
        ("PHANToM Omni", False), ("PHANToM Omni", False),
        ("PHANToM Omni", True), ("PHANToM Omni", True),
    ]  # fmt: skip


def test_the_figure_shows_errors_within_the_bound_of_friction(ball: BeatingSurface) -> None:
    """Fig. 14: a tool that nobody holds lags by what it takes to overcome friction, drag and its mass."""
    omni, turn = DEVICES["omni"], 2 * np.pi / 0.6
    moved_n = omni.viscous_n_s_per_m * 0.002 * turn + omni.mass_kg * 0.002 * turn**2
    runs = [hold_stylus(ball, with_fixture(omni, "force", compensate=c), cycles=2) for c in (False, True)]
    axes = tracking_figure(runs, motion="paper5mm", cycle_s=0.6).axes
    for run, shown, mean in zip(runs, axes[1].lines, axes[2].lines, strict=False):
        np.testing.assert_array_equal(y_of(shown), run.distance_mm[-1])
        left_n = omni.dry_n - run.stylus.feed_forward.friction_n
        bound_mm = run.stylus.law.half_width_mm(left_n + moved_n)
        assert y_of(mean).max() < bound_mm
        assert np.abs(y_of(shown)).max() < 2.5 * bound_mm, "a swing about the mean"
    assert y_of(mean).max() < y_of(axes[2].lines[0]).min(), "feed-forward helps"
    surface, tool = axes[0].lines
    np.testing.assert_allclose(y_of(surface) - y_of(tool), runs[0].distance_mm[-1], atol=1e-9)


def test_hearts_are_pooled_place_by_place(ball: BeatingSurface) -> None:
    run = hold_stylus(ball, with_fixture(DEVICES["premium"], "force", compensate=False), cycles=1)
    both = pool_hearts([run, run])
    assert both.distance_mm.shape == (4, 600)
    assert both.summary() == pytest.approx(run.summary())


def test_senseless_numbers_are_refused(ball: BeatingSurface) -> None:
    with pytest.raises(InvalidInputError, match="0 cycles"):
        hold_stylus(ball, with_fixture(DEVICES["premium"], "force", compensate=False), cycles=0)
