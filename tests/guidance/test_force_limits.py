"""No force beyond what a device holds, and no wall that is felt far from its surface."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dvf_ig.core import InvalidInputError, Rigid
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
)
from dvf_ig.guidance.device import COMMON_DEVICE, UNNAMED_FORCE_N
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.devices.simulated import OMNI, PREMIUM
from dvf_ig.guidance.laws import REACH_MM
from dvf_ig.guidance.margins import MarginOptions, widened
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, SimulatedServo
from dvf_ig.guidance.servo.loop_arrays import LoopArrays
from dvf_ig.kernels.dynamic import force_batch, force_tick
from dvf_ig.kernels.fixture_field import LAW
from dvf_ig.kernels.laws import LARGEST_FORCE_N
from dvf_ig.kernels.servo import tick as kernel
from dvf_ig.study.passivity import steady_transform

STRONG = DeviceLimits(stiffness_n_per_m=1e4, continuous_force_n=12.0, name="omega.3")
PATH = PathTarget.static("mr", [[0.0, 0.0, 12.0], [0.0, 9.0, 12.0]])


@pytest.mark.parametrize("cap_n", [20.1, 1000.0, math.inf, math.nan, 0.0, -1.0])
def test_no_law_composition_or_device_is_stronger_than_any_device(cap_n):
    for make in (
        lambda: Sigmoid(cap_n=cap_n),
        lambda: Confinement(cap_n=cap_n),
        lambda: Gaussian(cap_n=cap_n),
        lambda: FixtureSet(cap_n=cap_n),
        lambda: DeviceLimits(continuous_force_n=cap_n, name="any"),
        lambda: Contribution("mr", np.zeros(3), cap_n),
        lambda: compose([], [], frame="mr", cap_n=cap_n),
    ):
        with pytest.raises(
            InvalidInputError, match=r"no device holds more than 20 N|must be positive and finite"
        ):
            make()


def test_more_than_four_newtons_need_a_device_with_a_name(ball):
    strong = FixtureOptions(Sigmoid(1.0, 6.0), name="epicardium")
    with pytest.raises(
        InvalidInputError,
        match=r"fixture 'epicardium': force cap cap_n is 6 N; at most 4 N is allowed where no .*key 'device'",
    ):
        FixtureSet((strong,))
    with pytest.raises(InvalidInputError, match="joint cap is 6 N; at most 4 N"):
        FixtureSet(cap_n=6.0)
    with pytest.raises(InvalidInputError, match="more than 4 N needs the name of the device"):
        DeviceLimits(continuous_force_n=6.0)
    with pytest.raises(InvalidInputError, match=r"the PHANToM Omni holds 0\.88 N for long; lower it"):
        FixtureSet((FixtureOptions(Sigmoid(cap_n=1.0)),), device=OMNI.limits(fastest_mm_s=100.0))
    with pytest.raises(InvalidInputError, match="force cap cap_n is 6 N"):
        Evaluator(ball, strong.law)
    with pytest.raises(InvalidInputError, match="force cap cap_n is 6 N"):
        PathFixture(PATH, Gaussian(60.0, cap_n=6.0))
    assert Fixtures(ball, FixtureSet((strong,), device=STRONG)).parts
    assert FixtureSet((FixtureOptions(Sigmoid(0.4, UNNAMED_FORCE_N)),)).joint_cap_n == 4.0
    assert PREMIUM.limits(fastest_mm_s=100.0).continuous_force_n == 1.4
    assert replace(PREMIUM, largest_n=1.0).limits(fastest_mm_s=100.0).continuous_force_n == 1.0


def test_a_servo_refuses_fixtures_that_are_stronger_than_its_device(ball):
    fixtures = Fixtures(ball, FixtureSet((FixtureOptions(Sigmoid(1.0, 6.0)),), device=STRONG))
    device = RecordedDevice(np.zeros((1, 3)), 1000.0)
    with pytest.raises(InvalidInputError, match="the largest force of the fixtures is 6 N; at most 4 N"):
        SimulatedServo(fixtures, device)
    assert SimulatedServo(fixtures, device, limits=STRONG)


def test_a_law_s_reach_is_where_one_percent_of_its_cap_is_left():
    for law, outward in ((Sigmoid(0.7, 0.5, 1.5), -1.0), (Confinement(0.7, 0.5, 1.5), 1.0)):
        at = outward * np.array([law.reach_mm - 0.01, law.reach_mm, law.reach_mm + 0.01])
        felt = np.abs(law.potential(at))
        assert felt[0] > felt[1] > felt[2]
        assert felt[1] == pytest.approx(0.01, rel=1e-9)
    assert Gaussian().reach_mm == math.inf


@pytest.mark.parametrize("law", [Sigmoid, Confinement])
def test_a_wall_is_felt_near_its_surface(ball, law):
    """By its steepness, its depth or its margin, alone or together."""
    for far in (law(0.001), law(0.2), law(depth_mm=-16.0), law(0.3, depth_mm=-5.0)):
        for make in (lambda far=far: FixtureOptions(far), lambda far=far: Evaluator(ball, far)):
            with pytest.raises(
                InvalidInputError, match=r"would be felt .* mm from the organ's surface, at most 20"
            ):
                make()
    with pytest.raises(
        InvalidInputError, match=r"felt 4595 mm .* use a gamma of 0\.23 or more, or a larger depth"
    ):
        FixtureOptions(law(0.001))
    assert FixtureOptions(law(0.23)).law.reach_mm < REACH_MM
    assert FixtureOptions(law(0.1, depth_mm=30.0)).law.reach_mm < REACH_MM
    wide = (FixtureOptions(law(0.25)),)
    assert FixtureSet(wide, margin=MarginOptions("fixed", fixed_mm=1.5))
    for margin in (MarginOptions("fixed", fixed_mm=2.0), MarginOptions("adaptive")):
        with pytest.raises(InvalidInputError, match="and a margin of"):
            FixtureSet(wide, margin=margin)
    assert widened(wide[0].law, 5.0).reach_mm > REACH_MM  # a session's own margin is bounded above


@pytest.mark.parametrize("blend", ["force", "distance", "periodic"])
@pytest.mark.parametrize("law", [Sigmoid(), Confinement(), Gaussian()])
def test_the_force_kernels_have_a_ceiling_that_no_parameter_exceeds(ball, shell_points, law, blend):
    frame = ball.frame
    coefficients, packed = Evaluator(ball, law, blend=blend).kernel_arguments(Rigid.identity(frame, frame))
    n = len(shell_points)
    phase, distance, rate = np.full(n, 0.3), np.empty(n), np.empty(n)
    for cap_n in (1e3, -1e3, 1e300, math.inf):
        packed[LAW + 3] = cap_n
        for status in (Status.OK, Status.NO_PHASE):
            force, given = np.empty((n, 3)), np.full(n, int(status))
            force_batch(
                coefficients, packed, shell_points, phase, force, distance, np.empty((n, 3)), rate, given
            )
            length = np.linalg.norm(force, axis=1)
            assert length.max() <= LARGEST_FORCE_N * (1.0 + 1e-12)
            assert length.max() > 1.0 or (isinstance(law, Gaussian) and status == Status.NO_PHASE)
        out = np.empty(8)
        force_tick(coefficients, packed, shell_points[0].copy(), 0.3, int(Status.OK), out)
        assert np.linalg.norm(out[:3]) <= LARGEST_FORCE_N * (1.0 + 1e-12)


@pytest.mark.parametrize("spoilt", [1e3, 1e300, math.inf, math.nan])
def test_the_servo_sends_no_more_than_the_ceiling_whatever_its_numbers_say(ball, spoilt):
    """Caps, slew and feed-forward of a running servo, damaged: after seconds at the deepest point."""
    inside = RecordedDevice(np.tile([0.0, 0.0, 9.0], (4000, 1)), 1000.0)
    fixtures = Fixtures(ball, FixtureSet((FixtureOptions(Sigmoid()),)))
    servo = SimulatedServo(fixtures, inside, options=ServoOptions(residual_limit_mj=1e12))
    loop: LoopArrays = servo._loop
    bound = loop.bound
    bound.packed[:, LAW + 3] = spoilt  # the packed law's cap
    settings = bound.settings
    settings["fixtures"]["cap_n"] = settings["cap_n"] = settings["friction_n"] = spoilt
    settings["limits"]["slew_n_per_s"] = settings["limits"]["slow_slew_n_per_s"] = 1e9
    servo.run(
        ServoInputs(steady_transform(ball), 0.0, Rigid.identity("tracker", "device"), valid_for_s=9.0), 3000
    )
    sent = np.linalg.norm(inside.force_n, axis=1)
    assert np.isfinite(sent).all()
    assert sent.max() <= LARGEST_FORCE_N * (1.0 + 1e-12)
    assert spoilt != 1e3 or sent.max() == pytest.approx(LARGEST_FORCE_N)


def test_the_ceiling_shortens_and_does_not_turn():
    for force, expected in (
        ([3.0, -4.0, 0.0], [3.0, -4.0, 0.0]),
        ([0.0, 0.0, -20.0], [0.0, 0.0, -20.0]),
        ([300.0, -400.0, 0.0], [12.0, -16.0, 0.0]),
        ([math.nan, 0.0, 1.0], [0.0, 0.0, 0.0]),
        ([math.inf, 0.0, 1.0], [0.0, 0.0, 0.0]),
        ([1e200, 0.0, 1.0], [0.0, 0.0, 0.0]),
    ):
        sent = np.array(force)
        kernel._within_ceiling(sent)
        np.testing.assert_allclose(sent, expected, rtol=1e-15)


def test_what_was_allowed_stays_as_it_was(ball):
    assert COMMON_DEVICE.continuous_force_n == 4.0
    assert FixtureSet().joint_cap_n == 0.6
    assert FixtureOptions().law.reach_mm == pytest.approx(4.595, abs=1e-3)
    for gamma in (0.5, 1.0, 2.0, 4.0):  # Fig. 8 of Ren 2008
        law = FixtureOptions(Sigmoid(gamma)).law
        assert isinstance(law, Sigmoid)
        assert law.gamma_per_mm == gamma
