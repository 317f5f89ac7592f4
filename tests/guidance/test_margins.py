"""σ of the distance against sampling; margins that widen without a jump; walls where the phase is unknown."""

from dataclasses import replace

import numpy as np
import pytest
from readable_walls import worst_phase_forces
from toy_ball import CENTERS, RADII, ball_model

from dvf_ig.core import InvalidInputError, Rigid, SeenPart
from dvf_ig.guidance import Confinement, Evaluator, Fixtures, FixtureSet, Gaussian, Sigmoid, Status
from dvf_ig.guidance.margins import MarginOptions, distance_sigma, isotropic, next_margin_mm, widened
from dvf_ig.kernels.worst_phase import SMOOTHING_MM

IN_MODEL = Rigid.identity("mr", "mr")
LAWS = [Sigmoid(), Confinement(), Gaussian()]


@pytest.fixture(scope="module")
def model():
    return ball_model()


@pytest.fixture(scope="module")
def seen_model(model):
    """Slices show the ball's middle, in a slab that follows its centre, and a second one above."""
    heights = CENTERS @ [0.0, 0.6, 0.8]
    bounds = heights[:, None, None] + np.array([[-9.0, 4.0], [7.0, 10.0]])
    return replace(model, seen=SeenPart([0.0, 0.6, 0.8], bounds, [-10.0, 10.0], np.full(len(heights), 0.5)))


def covariance(seed: int) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(3, 3)) * 0.3
    return a @ a.T


def test_the_sigma_of_a_distance_is_that_of_sampled_distances():
    rng = np.random.default_rng(5)
    normal = np.array([2.0, -1.0, 2.0]) / 3.0
    parts = [covariance(k) for k in range(5)]
    found = distance_sigma(
        normal[None],
        np.array([-12.0]),
        np.array([0.03]),
        **dict(
            zip(
                ["registration_mm2", "shape_mm2", "calibration_mm2", "breathing_mm2", "tracking_mm2"],
                parts,
                strict=True,
            )
        ),
    )
    moved = sum(rng.multivariate_normal(np.zeros(3), part, size=100_000) for part in parts)
    d = -np.linalg.norm(1000.0 * normal - moved, axis=1) - 12.0 * rng.normal(0, 0.03, 100_000)
    assert found.total_mm[0] == pytest.approx(np.std(d), rel=0.02)
    assert found.phase_mm[0] == pytest.approx(0.36)
    assert found.registration_mm[0] == pytest.approx(np.sqrt(normal @ parts[0] @ normal))


def test_an_unknown_cause_makes_the_sigma_unknown_and_the_margin_the_cap():
    zero = isotropic(0.0)
    found = distance_sigma(
        np.eye(3)[:1],
        np.zeros(1),
        np.zeros(1),
        registration_mm2=np.full((1, 3, 3), np.nan),
        shape_mm2=zero,
        calibration_mm2=zero,
        breathing_mm2=zero,
        tracking_mm2=isotropic(0.25),
    )
    assert found.tracking_mm[0] == pytest.approx(0.25)
    options = MarginOptions("adaptive", largest_mm=4.0)
    assert options.wanted_mm(float(found.total_mm[0])) == 4.0


def test_the_three_modes():
    assert MarginOptions("off").wanted_mm(1.0) == 0.0
    assert MarginOptions("fixed", fixed_mm=1.5).wanted_mm(np.nan) == 1.5
    assert MarginOptions("adaptive").wanted_mm(1.0) == pytest.approx(1.6449, abs=1e-4)
    assert MarginOptions("adaptive").wanted_mm(100.0) == 5.0


@pytest.mark.parametrize("wrong", [{"mode": "none"}, {"fixed_mm": 6.0}, {"quantile": 1.0}, {"quantile": 0.2}])
def test_margins_that_cannot_be_are_refused(wrong):
    with pytest.raises(InvalidInputError):
        MarginOptions(**wrong)


@pytest.mark.parametrize("law", [Sigmoid(2.0, 2.0), Gaussian(), Sigmoid(0.5, 0.3)])
def test_a_margin_moves_to_the_wanted_one_within_the_slew_rules(law):
    step_n, dt_s = 0.1, 1.0 / 30.0
    path = [0.0]
    for _ in range(200):
        path.append(next_margin_mm(path[-1], 3.0, dt_s, law, step_n))
    steps = np.diff(path)
    assert path[-1] == 3.0
    assert steps.max() * law.stiffness_n_per_mm <= min(step_n, 6.0 * dt_s) + 1e-12
    assert steps.max() <= 10.0 * dt_s + 1e-12
    assert next_margin_mm(3.0, 0.0, dt_s, law, step_n) == pytest.approx(3.0 - steps.max())


@pytest.mark.parametrize("law", LAWS)
def test_a_widened_law_pushes_earlier_or_pulls_less(law):
    d = np.linspace(-6.0, 6.0, 25)
    wide = widened(law, 1.5)
    assert (np.abs(wide.potential(d)) >= np.abs(law.potential(d)))[d != 0].all() != isinstance(law, Gaussian)
    assert wide.stiffness_n_per_mm <= law.stiffness_n_per_mm


@pytest.mark.parametrize("blend", ["force", "distance", "periodic"])
@pytest.mark.parametrize("law", [Sigmoid(), Confinement()])
def test_without_a_phase_a_wall_is_that_of_the_worst_phase(model, shell_points, law, blend):
    """The ball's phases: max over them, and no more than τ log N beyond; stronger than at any phase."""
    evaluator = Evaluator(model, law, blend=blend)
    no_phase = np.full(len(shell_points), int(Status.NO_PHASE))
    found = evaluator.force_through(IN_MODEL, shell_points, np.nan, no_phase)
    each = RADII - np.linalg.norm(shell_points[:, None] - CENTERS, axis=2)
    outward = 1.0 if isinstance(law, Sigmoid) else -1.0
    beyond = outward * found.distance_mm - (outward * each).max(axis=1)
    assert beyond.min() > -0.05
    assert beyond.max() < SMOOTHING_MM * np.log(len(RADII)) + 0.05
    size = np.linalg.norm(found.force_n, axis=1)
    for phase in model.timing.fractions:
        known = np.linalg.norm(evaluator.force(shell_points, phase).force_n, axis=1)
        assert (size >= known - 0.01).all()
    assert (found.status == Status.NO_PHASE).all()
    assert not found.rate_mm_per_cycle.any()


@pytest.mark.parametrize("blend", ["force", "distance", "periodic"])
def test_no_force_where_no_slice_shows_the_surface(model, seen_model, shell_points, blend):
    """The force of the whole model times the readable share; margins are for who asks for them."""
    query = Rigid.from_rotation_vector([0.2, -0.1, 0.4], [3.0, -2.0, 1.0], "mr", "tracker")
    points = query.inverse().apply_array(shell_points)
    for phase in (0.0, 0.13, 0.97):
        whole = Evaluator(model, Sigmoid(), blend=blend).force_through(query, points, phase)
        found = Evaluator(seen_model, Sigmoid(), blend=blend).force_through(query, points, phase)
        turned = whole.gradient @ query.rotation.T
        share = seen_model.seen.share(shell_points, whole.distance_mm, turned, phase, model.timing)
        np.testing.assert_allclose(found.force_n, share[:, None] * whole.force_n, atol=1e-9)
        np.testing.assert_array_equal(found.status, np.where(share == 0.0, Status.UNSEEN, Status.OK))
        assert ((share > 0.0) & (share < 1.0)).sum() > 20
        assert (share == 0.0).sum() > 20
    everywhere = Evaluator(seen_model, Sigmoid(), blend=blend, withhold_unseen=False)
    assert np.array_equal(everywhere.force_through(query, points, 0.97).force_n, whole.force_n)


def test_the_margin_of_an_unseen_part_is_the_largest(seen_model, shell_points):
    fixed, adaptive = (FixtureSet(margin=MarginOptions(mode)) for mode in ("fixed", "adaptive"))
    status = {
        one: Fixtures(seen_model, one).evaluate(IN_MODEL, shell_points, 0.1).status
        for one in (fixed, adaptive)
    }
    assert (status[fixed] == Status.UNSEEN).any()
    assert (status[adaptive] == Status.OK).all()
    variance = seen_model.seen.covariance_mm2(
        shell_points, np.full(len(shell_points), np.nan), seen_model.timing
    )
    heights = np.clip(0.5 + shell_points @ [0.0, 0.6, 0.8] / 20.0, 0.0, 1.0)
    np.testing.assert_allclose(np.trace(variance, axis1=1, axis2=2), (0.5 * heights) ** 2)


@pytest.mark.parametrize("blend", ["force", "periodic"])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("which", ["model", "seen_model"])
def test_the_kernel_s_worst_phase_is_the_readable_one(request, which, shell_points, law, blend):
    """A periodic spline passes through the phases that it is made of."""
    model = request.getfixturevalue(which)
    query = Rigid.from_rotation_vector([0.2, -0.1, 0.4], [3.0, -2.0, 1.0], "mr", "tracker")
    points = query.inverse().apply_array(shell_points)
    odd = np.vstack([points, [[500.0, 0.0, 0.0], [np.nan, 0.0, 0.0]]])
    no_phase = np.full(len(odd), int(Status.NO_PHASE))
    found = Evaluator(model, law, blend=blend).force_through(query, odd, np.nan, no_phase)
    expected = worst_phase_forces(Evaluator(model, law), query, points)
    n = len(points)
    np.testing.assert_allclose(found.force_n[:n], expected.force_n, atol=1e-5)
    unseen = expected.status == Status.UNSEEN
    assert unseen.any() == (which == "seen_model" and not isinstance(law, Gaussian))
    np.testing.assert_allclose(found.distance_mm[:n], expected.distance_mm, atol=1e-4)
    np.testing.assert_allclose(found.gradient[:n], expected.gradient, atol=1e-4)
    np.testing.assert_array_equal(found.status[:n], expected.status)
    assert not found.force_n[n:].any()
    if not isinstance(law, Gaussian):
        assert found.status[n:].tolist() == [Status.OUT_OF_VOLUME, Status.FAULT]
    else:
        assert not found.force_n.any()


def test_the_force_of_the_worst_phase_turns_without_a_jump(model):
    """Where another phase becomes the worst, over 0.01 mm."""
    line = np.linspace([-25.0, 14.0, 3.0], [25.0, 14.0, 3.0], 5001)
    evaluator = Evaluator(model, Sigmoid())
    found = evaluator.force_through(IN_MODEL, line, np.nan, np.full(len(line), int(Status.NO_PHASE)))
    inside = found.status == Status.NO_PHASE
    steps = np.linalg.norm(np.diff(found.force_n[inside], axis=0), axis=1)
    assert np.linalg.norm(found.force_n, axis=1).max() > 0.3
    assert steps.max() < 0.01


def test_a_widened_law_is_what_the_servo_makes_of_a_margin():
    """The laws by which tests/guidance/servo/test_tick.py holds the servo's own widening."""
    assert widened(Sigmoid(1.0, 0.4), 1.5) == Sigmoid(1.0, 0.4, -1.5)
    assert widened(Confinement(1.0, 0.4, 9.0), 1.0) == Confinement(1.0, 0.4, 8.0)
    assert widened(Gaussian(6.0, 1.0, 0.3), 0.5) == Gaussian(6.5, 1.0, 0.3)
