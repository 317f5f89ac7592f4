"""Further structures of a session, each with its own law, and paths that beat with a surface."""

from dataclasses import replace

import numpy as np
import pytest
from toy_ball import CENTERS, FRACTIONS, RADII, structure

from dvf_ig.core import CycleTiming, FrameMismatchError, InvalidInputError, Mesh, Rigid
from dvf_ig.guidance import (
    DeviceLimits,
    Evaluator,
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Gaussian,
    PathTarget,
    Sigmoid,
    Status,
)
from dvf_ig.guidance.fixtures import composed_force
from dvf_ig.guidance.margins import MarginOptions

HERE = Rigid.identity("mr", "mr")
WALL = Sigmoid(1.0, 0.3)


@pytest.fixture(scope="module")
def atrium():
    return structure("atrium", [18.0, 4.0, 0.0], 8.0)


@pytest.fixture(scope="module")
def oesophagus():
    return structure("oesophagus", [30.0, 4.0, 0.0], 5.0, still=True)


@pytest.fixture(scope="module")
def nearby(rng_points):
    """(n, 3) places about both, inside and outside the oesophagus' box."""
    return np.array([20.0, 2.0, 0.0]) + rng_points


@pytest.fixture(scope="module")
def rng_points():
    return np.random.default_rng(3).uniform(-9.0, 9.0, (300, 3))


def test_each_fixture_is_that_of_its_own_structure(ball, atrium, oesophagus, nearby):
    """Forces compose, the first within reach is the primary one, and a wall far away takes no force."""
    phase = np.linspace(0.0, 1.0, len(nearby))
    options = FixtureSet(
        (
            FixtureOptions(WALL, structure=oesophagus),
            FixtureOptions(Gaussian(4.0, cap_n=0.3), "periodic", structure=atrium),
            FixtureOptions(WALL),
        ),
        0.6,
    )
    got = Fixtures(ball, options).evaluate(HERE, nearby, phase)
    wall, pull, heart = (
        Evaluator(of, one.law, blend=one.blend).force(nearby, phase)
        for of, one in zip((oesophagus, atrium, ball), options.fixtures, strict=True)
    )
    served = (pull.status == Status.OK) & (heart.status == Status.OK)
    far = wall.status == Status.OUT_OF_VOLUME
    assert (served & far).sum() > 20
    assert (served & ~far).sum() > 100
    np.testing.assert_array_equal(got.status == Status.OK, served)
    for i in np.flatnonzero(served):
        forces = np.stack([wall.force_n[i], pull.force_n[i], heart.force_n[i]])
        np.testing.assert_array_equal(got.force_n[i], composed_force(options, forces).force_n)
    expected = np.where(far, pull.distance_mm, wall.distance_mm)
    np.testing.assert_array_equal(got.distance_mm[served], expected[served])
    assert not wall.force_n[far].any()


def test_a_wall_alone_is_ok_and_without_force_where_it_is_far_away(ball, oesophagus):
    fixtures = Fixtures(ball, FixtureSet((FixtureOptions(WALL, structure=oesophagus),)))
    there = np.array([[0.0, 0.0, 0.0], [25.5, 4.0, 0.0], [200.0, 0.0, 0.0]])
    for status in (Status.OK, Status.NO_PHASE):
        samples = fixtures.evaluate(HERE, there, 0.3, np.full(3, int(status)))
        assert samples.status.tolist() == [status] * 3
        assert np.linalg.norm(samples.force_n, axis=1)[[0, 2]].tolist() == [0.0, 0.0]
        assert np.linalg.norm(samples.force_n[1]) > 0.1
        assert np.isnan(samples.distance_mm[[0, 2]]).all()


def test_guidance_on_a_structure_ends_with_its_box(ball, atrium):
    """It pulls from everywhere, so outside the box nothing is known of it: no force, as of the heart."""
    options = FixtureSet((FixtureOptions(Gaussian(), structure=atrium), FixtureOptions(WALL)), 0.6)
    samples = Fixtures(ball, options).evaluate(HERE, [[-15.0, 0.0, 0.0]], 0.3)
    assert samples.status[0] == Status.OUT_OF_VOLUME
    assert not samples.force_n.any()


def test_a_wall_of_a_still_structure_does_not_depend_on_the_phase(ball, oesophagus, nearby):
    assert oesophagus.still
    assert not ball.still
    fixtures = Fixtures(ball, FixtureSet((FixtureOptions(WALL, structure=oesophagus),)))
    first, later = (fixtures.evaluate(HERE, nearby, phase) for phase in (0.0, 0.37))
    np.testing.assert_allclose(later.force_n, first.force_n, atol=1e-12)
    lost = fixtures.evaluate(HERE, nearby, np.nan, np.full(len(nearby), int(Status.NO_PHASE)))
    push = np.linalg.norm(lost.force_n, axis=1) - np.linalg.norm(first.force_n, axis=1)
    assert (push >= 0.0).all()
    assert push.max() < 0.02


def test_structures_that_do_not_fit_are_refused(ball, atrium, oesophagus):
    def refused(message, one, **more):
        with pytest.raises(InvalidInputError, match=message):
            Fixtures(ball, FixtureSet((FixtureOptions(WALL), one), 0.6, **more))

    def wall(of, law=WALL):
        return FixtureOptions(law, name="second", structure=of)

    refused("second.*patient 'other'", wall(replace(atrium, patient_id="other")))
    refused("phase times", wall(replace(atrium, timing=CycleTiming(FRACTIONS, 0.9))))
    refused("phase times", wall(replace(atrium, timing=CycleTiming(FRACTIONS + 0.01, 0.8))))
    refused("ends 10.0 mm from its surface.*--margin-mm 1[2-9]", wall(oesophagus, Sigmoid(0.36, 0.3)))
    widened = {"margin": MarginOptions("adaptive")}
    refused("ends 10.0 mm", wall(oesophagus, Sigmoid(0.85, 0.3)), **widened)
    assert Fixtures(ball, FixtureSet((wall(oesophagus, Sigmoid(0.85, 0.3)),)))
    refused("where their surfaces touch", wall(atrium, Sigmoid(2.4, 0.6)))
    stiff = DeviceLimits(stiffness_n_per_m=500.0)
    assert Fixtures(ball, FixtureSet((FixtureOptions(WALL), wall(atrium, Sigmoid(2.4, 0.6))), device=stiff))
    elsewhere = replace(atrium, frame="ct", reference=tuple(replace(m, frame="ct") for m in atrium.reference))
    with pytest.raises(FrameMismatchError):
        Fixtures(ball, FixtureSet((wall(elsewhere),)))


def test_a_path_beats_with_the_surface_that_it_was_drawn_on(atrium):
    """To 0.05 mm of the ball's own motion, at every phase; at end-diastole it is where it was drawn."""
    direction = np.array([[0.0, 0.0, 1.0], [0.3, 0.2, 0.9], [0.6, 0.3, 0.7]])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    center = np.array([18.0, 4.0, 0.0])
    path = PathTarget.beating(atrium, center + 8.0 * direction)
    for phase, (radius, drift) in enumerate(zip(RADII / RADII[0] * 8.0, CENTERS, strict=True)):
        np.testing.assert_allclose(path.points_mm[phase], center + drift + radius * direction, atol=0.05)
    np.testing.assert_array_equal(path.points_mm[0], center + 8.0 * direction)
    assert path.timing is atrium.timing


def test_paths_that_cannot_beat_are_refused(atrium, oesophagus):
    on_it = np.array([[35.0, 4.0, 0.0], [34.0, 6.0, 0.0]])
    assert PathTarget.beating(oesophagus, on_it).timing is None
    with pytest.raises(InvalidInputError, match=r"point 1 of a path is 1\d\.\d mm from atrium"):
        PathTarget.beating(atrium, [[26.0, 4.0, 0.0], [39.0, 4.0, 0.0]])
    other = Mesh("mr", atrium.reference[1].vertices_mm, atrium.reference[1].triangles[::-1])
    changing = replace(atrium, reference=(atrium.reference[0], other, *atrium.reference[2:]))
    with pytest.raises(InvalidInputError, match="different triangles"):
        PathTarget.beating(changing, [[26.0, 4.0, 0.0], [25.0, 7.0, 0.0]])
