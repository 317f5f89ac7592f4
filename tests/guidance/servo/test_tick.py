"""The tick of the servo against its readable form, and what its inputs do."""

import numpy as np
import pytest

from dvf_ig.core import InvalidInputError, Rigid
from dvf_ig.guidance import (
    Confinement,
    DeviceLimits,
    FeedForward,
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Gaussian,
    Hazard,
    PathTarget,
    Sigmoid,
    Status,
    SupervisorState,
)
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, SimulatedServo
from dvf_ig.guidance.servo.twin import ReadableTick

from .conftest import RATE_HZ, TRACKER_FROM_DEVICE

LIMITS = DeviceLimits(stiffness_n_per_m=400.0)
OPTIONS = ServoOptions(feed_forward=FeedForward(damping_n_s_per_m=0.5, friction_n=0.02))


class Late(RecordedDevice):
    """A recorded device whose forces are felt 2 ms late."""

    latency_s = 0.002


def words(moving, ticks, every=33):
    """What a session says, and for how many ticks: quiet, hazards, silence, a tool that is lost."""
    for first in range(0, ticks, every):
        hazards = Hazard.POSE_MOVING if first < 3 * every else Hazard.NONE
        hazards |= Hazard.NO_PHASE if first in range(15 * every, 17 * every) else Hazard.NONE
        status = Status.STALE_TOOL if first == 25 * every else Status.OK
        hazards |= Hazard.STALE_TOOL if status != Status.OK else Hazard.NONE
        valid = 0.01 if first == 35 * every else 0.1
        inputs = ServoInputs(moving, first / RATE_HZ, TRACKER_FROM_DEVICE, hazards, status, valid_for_s=valid)
        yield inputs, min(every, ticks - first)


def test_the_kernel_s_tick_is_the_readable_one(moving, three, path_mm):
    device = Late(path_mm, RATE_HZ)
    servo = SimulatedServo(three, device, limits=LIMITS, options=OPTIONS)
    twin = ReadableTick(three, LIMITS, OPTIONS, device.latency_s)
    tick, states = 0, set()
    for inputs, count in words(moving, 1300):
        record = servo.run(inputs, count)
        for k in range(count):
            expected = twin.step(float(record.t_s[k]), path_mm[tick], inputs)
            np.testing.assert_allclose(record.sent_n[k], expected.force_n, atol=1e-9)
            assert (record.state[k], record.hazards[k]) == (expected.state, expected.hazards)
            np.testing.assert_allclose(record.residual_mj[k], twin.observer.residual_mj, atol=1e-9)
            states.add(expected.state)
            tick += 1
        np.testing.assert_allclose(record.given_mj[-1], twin.observer.given_mj, atol=1e-9)
        np.testing.assert_allclose(record.by_surface_mj[-1], twin.observer.by_surface_mj, atol=1e-9)
    assert states >= {SupervisorState.OK, SupervisorState.DEGRADED, SupervisorState.FADE}
    assert abs(twin.observer.by_surface_mj) > 0.01


def test_the_device_gets_the_force_in_its_own_frame(moving, three, path_mm):
    device = RecordedDevice(path_mm, RATE_HZ)
    record = SimulatedServo(three, device).run(
        ServoInputs(moving, 0.0, TRACKER_FROM_DEVICE, valid_for_s=9.0), 400
    )
    back = TRACKER_FROM_DEVICE.rotation.T
    np.testing.assert_allclose(device.force_n[:400], record.sent_n @ back.T, atol=1e-15)
    assert np.abs(record.sent_n).max() > 0.1


def field(ball, transform, path_mm, fixtures, margin_mm=()):
    device = RecordedDevice(path_mm, RATE_HZ)
    inputs = ServoInputs(
        transform, 0.0, TRACKER_FROM_DEVICE, margin_mm=np.array(margin_mm, dtype=float), valid_for_s=9.0
    )
    options = ServoOptions(predict_tool=False)
    return SimulatedServo(Fixtures(ball, fixtures), device, options=options).run(inputs, 200).field_n


def test_a_margin_widens_a_region_and_softens_guidance(ball, moving, path_mm):
    narrow = FixtureSet(
        (
            FixtureOptions(Sigmoid(1.0, 0.4)),
            FixtureOptions(Confinement(1.0, 0.4, 9.0)),
            FixtureOptions(Gaussian(6.0, 1.0, 0.3)),
        ),
        0.6,
    )
    wide = FixtureSet(
        (
            FixtureOptions(Sigmoid(1.0, 0.4, -1.5)),
            FixtureOptions(Confinement(1.0, 0.4, 8.0)),
            FixtureOptions(Gaussian(6.5, 1.0, 0.3)),
        ),
        0.6,
    )
    by_margin = field(ball, moving, path_mm, narrow, (1.5, 1.0, 0.5))
    np.testing.assert_allclose(by_margin, field(ball, moving, path_mm, wide), atol=1e-12)
    assert np.abs(by_margin - field(ball, moving, path_mm, narrow)).max() > 0.01


def test_two_equal_walls_take_two_thirds_of_the_guidance_that_leads_in(ball, moving, path_mm):
    """At f = ½ each: w = 2·f/(1−f) = 2, taken w/(1+w); the composition is that of the replay."""
    one = FixtureOptions(Sigmoid(1.0, 0.3))
    guide = FixtureOptions(Gaussian(5.0, 0.5, 0.3, depth_mm=4.0))
    both = field(ball, moving, path_mm, FixtureSet((one, one, guide), 5.0))
    fixtures = Fixtures(ball, FixtureSet((one, one, guide), 5.0))
    t_s = np.arange(200) / RATE_HZ + 0.5e-3
    tip = TRACKER_FROM_DEVICE.apply_array(path_mm[:200])
    place = moving.at(tip, t_s)
    for k in (0, 50, 150):
        replayed = fixtures.evaluate(moving.pose.at(t_s[k]), tip[k : k + 1], place.model_phase[k])
        np.testing.assert_allclose(both[k], replayed.force_n[0], atol=1e-12)


def test_a_position_that_is_not_finite_releases_and_latches(moving, three, path_mm):
    broken = path_mm.copy()
    broken[600:] = np.nan
    inputs = ServoInputs(moving, 0.0, TRACKER_FROM_DEVICE, valid_for_s=9.0)
    record = SimulatedServo(three, RecordedDevice(broken, RATE_HZ)).run(inputs, 700)
    assert np.isfinite(record.sent_n).all()
    assert np.abs(record.sent_n[599]).max() > 0.0
    assert not record.sent_n[621:].any()
    assert record.state[-1] == SupervisorState.LATCHED
    assert record.hazards[-1] & Hazard.NOT_FINITE


def test_a_device_that_no_longer_answers_latches(moving, three, path_mm):
    inputs = ServoInputs(moving, 0.0, TRACKER_FROM_DEVICE, valid_for_s=9.0)
    record = SimulatedServo(three, RecordedDevice(path_mm[:300], RATE_HZ)).run(inputs, 340)
    assert record.hazards[299] & Hazard.DEVICE_LOST == 0
    assert record.hazards[300] & Hazard.DEVICE_LOST
    assert record.state[-1] == SupervisorState.LATCHED
    assert not record.sent_n[-1].any()


def test_paths_and_too_many_fixtures_are_refused(ball):
    path = PathTarget.static("mr", [[0.0, 0, 0], [1.0, 0, 0]])
    to_path = FixtureSet((FixtureOptions(), FixtureOptions(Gaussian(5.0, 1.0, 0.3), path=path)))
    device = RecordedDevice(np.zeros((1, 3)), RATE_HZ)
    with pytest.raises(InvalidInputError, match="path"):
        SimulatedServo(Fixtures(ball, to_path), device)
    many = FixtureSet((FixtureOptions(Sigmoid(0.1, 0.1)),) * 9)
    with pytest.raises(InvalidInputError, match="up to 8"):
        SimulatedServo(Fixtures(ball, many), device)


@pytest.mark.parametrize("margin", [[-1.0], [1.0] * 9])
def test_margins_that_cannot_be_are_refused(moving, margin):
    with pytest.raises(InvalidInputError, match="margins"):
        ServoInputs(moving, 0.0, Rigid.identity("tracker", "device"), margin_mm=np.array(margin))
