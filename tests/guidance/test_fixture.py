"""Fixtures bound to a model: one is its evaluator to the bit, several are composed, one refusal is of all."""

import numpy as np
import pytest
from readable_fixtures import CONFLICT, DISTANCE, FORCE, GRADIENT, RATE, TICK_OUTPUT, TickedFixtures

from dvf_ig.core import CycleTiming, FrameMismatchError, InvalidInputError, Rigid
from dvf_ig.guidance import (
    Confinement,
    Contribution,
    DeviceLimits,
    Evaluator,
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Gaussian,
    PathFixture,
    PathTarget,
    Sigmoid,
    Status,
    compose,
    force_at_distance,
    static_force,
)

POSE = Rigid.from_rotation_vector([0.4, -1.1, 0.7], [30.0, -80.0, 12.0], "mr", "tracker")
PATH = PathTarget.static("mr", [[-8.0, 0.0, 12.0], [0.0, 3.0, 15.0], [9.0, 1.0, 11.0]])
MOVING = PathTarget(
    "mr",
    np.stack([PATH.points_mm[0] + shift for shift in (0.0, 1.0, 2.0, 1.0)]),
    CycleTiming(np.array([0.05, 0.3, 0.55, 0.8]), 0.8),
)
WALL, GUIDE = FixtureOptions(Sigmoid()), FixtureOptions(Gaussian(3.0, 1.0, 0.5), path=PATH)
ONE = {
    "forbidden": FixtureOptions(Sigmoid(2.0, 0.5, 1.0), "distance"),
    "confinement": FixtureOptions(Confinement()),
    "guidance": FixtureOptions(Gaussian(3.0, 1.0), "periodic"),
    "path": GUIDE,
    "moving path": FixtureOptions(Gaussian(4.0, 2.0), path=MOVING),
}
SEVERAL = {
    "wall and path": FixtureSet((WALL, GUIDE)),
    "path and wall": FixtureSet((GUIDE, WALL), cap_n=0.4),
    "two depths and a guide": FixtureSet(
        (WALL, FixtureOptions(Sigmoid(depth_mm=3.0)), FixtureOptions(Gaussian(3.0, depth_mm=4.0)))
    ),
}


def ticks(fixtures, pose, points, phase, status):
    """`TickedFixtures.tick` at every point."""
    out, found = np.empty((len(points), TICK_OUTPUT)), []
    for i, point in enumerate(points):
        given = (pose.matrix[:3], point, float(phase[i]), int(status[i]), out[i])
        found.append(fixtures.tick(*given))
    return out, np.array(found)


def mixed_inputs(shell_points):
    """Points through a pose, phases beyond one cycle, one point away from the model, some faults."""
    points = POSE.inverse().apply_array(shell_points[:60])
    phase = np.linspace(-0.5, 1.5, 60)
    status = np.zeros(60, dtype=np.int64)
    points[5], points[6], phase[7], status[8] = 1e3, np.nan, np.inf, Status.STALE_TOOL
    points[9, 1] = np.inf
    return points, phase, status


@pytest.mark.parametrize("options", [*(FixtureSet((o,)) for o in ONE.values()), *SEVERAL.values()])
def test_a_tick_is_the_batch_to_the_bit(ball, shell_points, options):
    points, phase, status = mixed_inputs(shell_points)
    fixtures = TickedFixtures(ball, options)
    batch = fixtures.evaluate(POSE, points, phase, status)
    out, found = ticks(fixtures, POSE, points, phase, status)
    assert batch.frame == "tracker"
    np.testing.assert_array_equal(found, batch.status)
    np.testing.assert_array_equal(out[:, FORCE], batch.force_n)
    np.testing.assert_array_equal(out[:, DISTANCE], batch.distance_mm)
    np.testing.assert_array_equal(out[:, GRADIENT], batch.gradient)
    np.testing.assert_array_equal(out[:, RATE], batch.rate_mm_per_cycle)
    np.testing.assert_array_equal(out[:, CONFLICT] == 1.0, batch.conflict)
    assert (found[:5] == Status.OK).all()
    assert found[8] == Status.STALE_TOOL
    assert (found[[6, 7, 9]] == Status.FAULT).all()
    refused = found != Status.OK
    assert not batch.force_n[refused].any()
    assert not batch.conflict[refused].any()
    assert np.isnan(batch.distance_mm[refused]).all()


@pytest.mark.parametrize("name", ["forbidden", "confinement", "guidance"])
def test_one_surface_fixture_is_its_evaluator(ball, shell_points, name):
    points, phase, status = mixed_inputs(shell_points)
    got = Fixtures(ball, FixtureSet((ONE[name],))).evaluate(POSE, points, phase, status)
    expected = Evaluator(ball, ONE[name].law, blend=ONE[name].blend)
    same = expected.force_through(POSE, points, phase, status)
    for field in ("force_n", "distance_mm", "gradient", "status", "rate_mm_per_cycle"):
        np.testing.assert_array_equal(getattr(got, field), getattr(same, field))


@pytest.mark.parametrize("name", ["path", "moving path"])
def test_a_path_through_a_pose_is_the_path_in_the_model(ball, shell_points, name):
    phase = np.linspace(0.0, 1.0, len(shell_points))
    fixture = PathFixture(ONE[name].path, ONE[name].law)
    there = fixture.force(shell_points, phase)
    tip = POSE.inverse().apply_array(shell_points)
    through = Fixtures(ball, FixtureSet((ONE[name],))).evaluate(POSE, tip, phase)
    np.testing.assert_allclose(through.force_n @ POSE.rotation.T, there.force_n, atol=1e-9)
    np.testing.assert_allclose(through.gradient @ POSE.rotation.T, there.gradient, atol=1e-9)
    np.testing.assert_allclose(through.distance_mm, there.distance_mm, atol=1e-9)


@pytest.mark.parametrize("options", SEVERAL.values(), ids=SEVERAL.keys())
def test_several_are_composed_by_hand(ball, shell_points, options):
    """Each fixture alone, then `compose`: forbidden before guidance, the largest cap unless one is given."""
    phase = np.linspace(0.0, 1.0, 60)
    tip = POSE.inverse().apply_array(shell_points[:60])
    got = Fixtures(ball, options).evaluate(POSE, tip, phase)
    alone = [Fixtures(ball, FixtureSet((o,))).evaluate(POSE, tip, phase) for o in options.fixtures]
    conflicts = []
    for i in range(60):
        parts = [
            (not isinstance(o.law, Gaussian), Contribution("tracker", a.force_n[i], o.law.cap_n))
            for o, a in zip(options.fixtures, alone, strict=True)
        ]
        by_hand = compose(
            [c for forbidden, c in parts if forbidden],
            [c for forbidden, c in parts if not forbidden],
            frame="tracker",
            cap_n=options.cap_n or 0.6,
        )
        np.testing.assert_array_equal(got.force_n[i], by_hand.force_n)
        assert got.conflict[i] == by_hand.conflict
        conflicts.append(by_hand.conflict)
    assert any(conflicts)
    assert not all(conflicts)
    np.testing.assert_array_equal(got.distance_mm, alone[0].distance_mm)
    np.testing.assert_array_equal(got.gradient, alone[0].gradient)


def test_outside_the_model_s_box_a_path_gives_no_force_either(ball):
    outside = np.array([[0.0, 0.0, 200.0]])
    here = Rigid.identity("mr", "mr")
    assert Fixtures(ball, FixtureSet((GUIDE,))).evaluate(here, outside, 0.1).status[0] == Status.OK
    both = Fixtures(ball, FixtureSet((GUIDE, WALL))).evaluate(here, outside, 0.1)
    assert both.status[0] == Status.OUT_OF_VOLUME
    assert not both.force_n.any()


def test_a_joint_cap_shortens_a_single_fixture_too(ball, shell_points):
    free = Fixtures(ball).evaluate(POSE, POSE.inverse().apply_array(shell_points), 0.2)
    held = Fixtures(ball, FixtureSet(cap_n=0.2)).evaluate(POSE, POSE.inverse().apply_array(shell_points), 0.2)
    size = np.linalg.norm(free.force_n, axis=1)
    assert size.max() > 0.3
    np.testing.assert_allclose(
        held.force_n, free.force_n * np.minimum(1.0, 0.2 / size)[:, None], rtol=0, atol=1e-15
    )


def test_the_pose_may_change_at_every_tick(ball):
    """Nothing of the last tick's pose is left."""
    fixtures, out = TickedFixtures(ball), np.empty(TICK_OUTPUT)
    point = np.array([0.0, 0.0, 14.0])
    here = Fixtures(ball).evaluate(Rigid.identity("mr", "mr"), point[None], 0.1)
    for pose in (POSE, Rigid.identity("mr", "tracker")):
        assert fixtures.tick(pose.matrix[:3], pose.inverse().apply_array(point), 0.1, 0, out) == Status.OK
        np.testing.assert_allclose(pose.rotation @ out[FORCE], here.force_n[0], atol=1e-9)


@pytest.mark.parametrize("options", [FixtureSet(), SEVERAL["two depths and a guide"], FixtureSet(cap_n=0.1)])
def test_the_force_at_a_known_distance_is_that_of_the_laws(options):
    distance = np.linspace(-5, 5, 11)
    normal = np.tile([0.0, 0.6, 0.8], (11, 1))
    got = force_at_distance(options, distance, normal)
    assert got is not None
    for i in range(11):
        forces = [static_force(o.law, distance[i : i + 1], normal[i : i + 1])[0] for o in options.fixtures]
        sides = [
            [
                Contribution("mr", f, 0.6)
                for o, f in zip(options.fixtures, forces, strict=True)
                if o.forbidden is s
            ]
            for s in (True, False)
        ]
        by_hand = compose(*sides, frame="mr", cap_n=options.joint_cap_n).force_n
        np.testing.assert_allclose(got[i], by_hand, atol=1e-15)


def test_a_distance_to_the_organ_is_not_one_to_a_path():
    assert force_at_distance(SEVERAL["wall and path"], np.zeros(1), np.eye(3)[:1]) is None


def test_fixtures_on_one_surface_are_held_to_the_device_together(ball):
    """Two sigmoids of 240 N/m add up to 480 at one depth, and to little more than 240 far apart."""
    one = FixtureOptions(Sigmoid(2.0, 0.48))
    with pytest.raises(InvalidInputError, match=r"together are too stiff .*: 480 N/m .*at most 400 N/m"):
        Fixtures(ball, FixtureSet((one, one), cap_n=1.0))
    assert Fixtures(ball, FixtureSet((one, FixtureOptions(Sigmoid(2.0, 0.48, 5.0))), cap_n=1.0)).parts
    assert Fixtures(ball, FixtureSet((one, one), device=DeviceLimits(stiffness_n_per_m=500.0))).parts
    on_a_path = FixtureOptions(Gaussian(1.5, 1.0, 0.48), path=PATH)
    assert Fixtures(ball, FixtureSet((one, on_a_path))).parts


def test_what_is_refused(ball):
    with pytest.raises(InvalidInputError, match="holds no fixture"):
        FixtureSet(())
    with pytest.raises(InvalidInputError, match="joint cap is 0 N"):
        FixtureSet(cap_n=0.0)
    with pytest.raises(InvalidInputError, match="choose one of force, distance, periodic"):
        FixtureOptions(blend="nearest")
    stiff = FixtureOptions(Sigmoid(3.0), name="epicardium")
    with pytest.raises(InvalidInputError, match=r"fixture 'epicardium': .*450 N/m at its steepest"):
        Fixtures(ball, FixtureSet((stiff,)))
    assert Fixtures(ball, FixtureSet((stiff,), device=DeviceLimits(stiffness_n_per_m=1000.0))).parts
    with pytest.raises(InvalidInputError, match="Sigmoid law"):
        Fixtures(ball, FixtureSet((FixtureOptions(path=PATH),)))
    elsewhere = PathTarget.static("ct", PATH.points_mm[0])
    with pytest.raises(FrameMismatchError, match=r"'mr'.*'ct'"):
        Fixtures(ball, FixtureSet((FixtureOptions(Gaussian(), path=elsewhere),)))
    for options in (FixtureSet(), FixtureSet((GUIDE,)), SEVERAL["wall and path"]):
        with pytest.raises(FrameMismatchError, match=r"'ct'.*'mr'"):
            Fixtures(ball, options).evaluate(Rigid.identity("ct", "tracker"), np.zeros((1, 3)), 0.1)
        with pytest.raises(InvalidInputError, match="points has shape"):
            Fixtures(ball, options).evaluate(POSE, np.zeros(3), 0.1)
