"""What the tool truly meets: exact distances to a moving mesh, and a task that respects hand and heart."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from toy_sphere import sphere

from data_synth.heart.clock import HeartClock
from data_synth.operator.contact import MovingSurface, tool_truth
from data_synth.operator.contact_sites import contact_sites
from data_synth.operator.tool_path import TipPath, ToolSpec, tip_path, tool_path
from data_synth.signals.rhythm import RhythmSpec, beat_series
from dvf_ig.core import FloatArray, IntArray, InvalidInputError, Points

ACCESS = np.array([0.6, -0.7, 0.2]) / np.linalg.norm([0.6, -0.7, 0.2])


class BeatingBall:
    """A ball of 50 mm whose surface draws back by up to `travel_mm`, more on one side than on the other."""

    center_mm = np.array([40.0, -25.0, 60.0])

    def __init__(self, travel_mm: float = 5.0, splits: int = 4, *, even: bool = False) -> None:
        self.unit, self.surface_triangles = sphere(1.0, splits)
        self.share = np.ones(len(self.unit)) if even else 0.3 + 0.35 * (self.unit[:, 2] + 1)
        self.travel_mm = travel_mm

    def surface_vertices(self, model_phase: float) -> FloatArray:
        depth = self.travel_mm * np.sin(np.pi * model_phase) ** 2 * self.share
        return np.asarray(self.center_mm + self.unit * (50.0 - depth)[:, None])


def brute_force(vertices: FloatArray, triangles: IntArray, point: FloatArray) -> float:
    """Distance to the nearest triangle: plane foot where inside, else the nearest of three segments."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    height = np.einsum("ij,ij->i", point - a, normal)
    foot = point - height[:, None] * normal
    inside = np.ones(len(a), dtype=bool)
    best = np.inf
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(q - p, foot - p), normal) >= 0
        along = np.einsum("ij,ij->i", point - p, q - p) / np.einsum("ij,ij->i", q - p, q - p)
        nearest = p + np.clip(along, 0, 1)[:, None] * (q - p)
        best = min(best, float(np.linalg.norm(nearest - point, axis=1).min()))
    return min(best, float(np.abs(height[inside]).min()) if inside.any() else np.inf)


@pytest.fixture(scope="module")
def ball() -> MovingSurface:
    return MovingSurface.of(BeatingBall())


def test_distance_equals_brute_force(ball: MovingSurface) -> None:
    rng = np.random.default_rng(1)
    points = BeatingBall.center_mm + rng.standard_normal((200, 3)) * 40.0
    phases = rng.uniform(0, 1, 200)
    distance, _ = ball.distance(points, phases)
    for point, phase, got in zip(points, phases, distance, strict=True):
        assert abs(got) == pytest.approx(brute_force(ball.at(phase), ball.triangles, point), abs=1e-9)


def test_sphere_has_its_closed_form() -> None:
    surface = MovingSurface.of(BeatingBall(even=True, splits=5))
    rng = np.random.default_rng(2)
    direction = rng.standard_normal((2000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    reach, phase = rng.uniform(5.0, 90.0, 2000), rng.uniform(0, 1, 2000)
    distance, gradient = surface.distance(BeatingBall.center_mm + direction * reach[:, None], phase)
    expected = 50.0 - 5.0 * np.sin(np.pi * phase) ** 2 - reach
    corners = surface.at(0.0)[surface.triangles]
    longest_edge_mm = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    sag_mm = longest_edge_mm**2 / 6 / 45.0  # depth of the middle of an equilateral facet
    assert np.abs(distance - expected).max() < sag_mm + surface.interpolation_error_mm
    assert (
        np.einsum("ij,ij->i", gradient, -direction) > 0.9995
    ).all()  # facets turn by 2° from one to the next
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, atol=1e-12)


@given(st.integers(0, 10_000))
def test_gradient_is_the_derivative_of_the_distance_but_for_the_facets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    surface = _BALL
    point = BeatingBall.center_mm + rng.standard_normal(3) * 35.0
    phase = np.full(7, rng.uniform())
    h = 1e-5
    steps = np.vstack([np.zeros(3), h * np.eye(3), -h * np.eye(3)])
    distance, gradient = surface.distance(point + steps, phase)
    numeric = (distance[1:4] - distance[4:7]) / (2 * h)
    turn = _largest_turn(surface.at(float(phase[0])), surface.triangles)
    # the distance has a kink on the medial axis; elsewhere they differ by no more than facet and corner
    assert np.linalg.norm(numeric - gradient[0]) <= turn or np.linalg.norm(numeric) < 0.999


def _largest_turn(vertices: FloatArray, triangles: IntArray) -> float:
    """Largest distance between the unit normals of a facet and of its corners, doubled."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    corner = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(corner, triangles[:, k], normal)
    corner /= np.linalg.norm(corner, axis=1)[:, None]
    return 2 * float(np.linalg.norm(corner[triangles] - normal[:, None], axis=2).max())


_BALL = MovingSurface.of(BeatingBall(splits=3))


def test_sign_is_right_next_to_sharp_edges_and_corners() -> None:
    class Needle:
        """A tetrahedron with dihedral angles far below 90°."""

        surface_triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])

        def surface_vertices(self, model_phase: float) -> FloatArray:
            return np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [5.0, 1.0, 0.0], [5.0, 0.4, 9.0]])

    surface = MovingSurface.of(Needle())
    rng = np.random.default_rng(4)
    corners = Needle().surface_vertices(0.0)
    inside = rng.dirichlet(np.ones(4) * 0.3, 500) @ corners
    near = corners[rng.integers(4, size=500)] + rng.standard_normal((500, 3)) * 0.5
    barycentric = np.linalg.solve(np.vstack([corners.T, np.ones(4)]), np.c_[near, np.ones(500)].T).T
    truly_inside = (barycentric > 0).all(axis=1)
    assert (surface.distance(inside, np.zeros(500))[0] >= -1e-9).all()
    assert np.array_equal(surface.distance(near, np.zeros(500))[0] > 0, truly_inside)


def test_cached_phases_stay_within_the_stated_error() -> None:
    heart = BeatingBall(14.0)
    surface = MovingSurface.of(heart)
    assert surface.interpolation_error_mm <= 0.005
    for phase in np.random.default_rng(5).uniform(0, 1, 50):
        miss = np.linalg.norm(surface.at(phase) - heart.surface_vertices(phase), axis=1).max()
        assert miss <= 0.005


def test_an_open_or_jumping_surface_is_refused() -> None:
    heart = BeatingBall(splits=1)
    heart.surface_triangles = heart.surface_triangles[1:]
    with pytest.raises(InvalidInputError, match="3 open"):
        MovingSurface.of(heart)

    class Jumping(BeatingBall):
        def surface_vertices(self, model_phase: float) -> FloatArray:
            return super().surface_vertices(0.0) + (model_phase > 0.3)

    with pytest.raises(InvalidInputError, match="jumps"):
        MovingSurface.of(Jumping(splits=1))


@cache
def _task(travel_mm: float, seed: int) -> tuple[MovingSurface, HeartClock, TipPath]:
    surface = MovingSurface.of(BeatingBall(travel_mm))
    rng = np.random.default_rng(seed)
    clock = HeartClock(beat_series(RhythmSpec(), -3.0, 63.0, rng).r_peaks_s, 0.86, 0.36)
    sites = contact_sites(surface, ACCESS, 6, rng)
    return surface, clock, tip_path(surface, clock, sites, 60.0, ToolSpec(), rng)


@pytest.mark.parametrize(("travel_mm", "seed"), [(5.0, 1), (5.0, 2), (14.0, 3)])
def test_the_tool_keeps_away_then_touches_and_presses_gently(travel_mm: float, seed: int) -> None:
    surface, clock, tip = _task(travel_mm, seed)
    t = np.arange(12_000) / 200.0
    truth = tool_truth(surface, clock, t, tip(t))
    assert truth.distance_mm[t < 12.0].max() < -15.0
    assert (truth.distance_mm >= 0).mean() >= 0.25
    assert truth.distance_mm.max() <= (3.0 if travel_mm <= 5 else 5.0)
    speed = np.linalg.norm(np.diff(truth.tip_mr_mm[::2], axis=0), axis=1) / 0.01
    assert speed.max() < 32.0
    touches = np.flatnonzero(np.diff((truth.distance_mm > -5.0).astype(int)) == 1)
    assert len(touches) >= 4


def test_truth_phases_are_the_clocks() -> None:
    surface, clock, tip = _task(5.0, 1)
    t = np.arange(0.0, 20.0, 0.01)
    truth = tool_truth(surface, clock, t, tip(t))
    np.testing.assert_array_equal(truth.phi, clock.phi(t))
    np.testing.assert_array_equal(truth.model_phase, clock.model_phase(t))


def test_the_tool_turns_about_its_tip_rigidly() -> None:
    _, _, tip = _task(5.0, 1)
    offset = np.array([10.0, -20.0, 148.0])
    t = np.arange(0.0, 60.0, 0.01)
    rng = np.random.default_rng(7)
    rotations, translations = tool_path(tip, ACCESS, Points("tool", offset[None]), rng)(t)
    np.testing.assert_allclose(rotations @ offset + translations, tip(t), atol=1e-9)
    np.testing.assert_allclose(
        rotations @ np.swapaxes(rotations, 1, 2), np.broadcast_to(np.eye(3), rotations.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0, atol=1e-12)
    handle = -rotations @ (offset / np.linalg.norm(offset))
    assert (handle @ ACCESS).min() > np.cos(np.deg2rad(30))
