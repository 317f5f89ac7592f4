"""The tick of the servo against its readable form, and what its inputs do."""

from dataclasses import replace

import numpy as np
import pytest
from readable_tick import ReadableTick
from toy_ball import structure

from dvf_ig.core import CycleTiming, InvalidInputError, PhaseState, Rigid
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
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, ServoRecord, SimulatedServo

from .conftest import RATE_HZ, THREE, TRACKER_FROM_DEVICE, beat

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


def losing_phase(moving, ticks, every=33):
    """The phase ends at 0.3 s, is known again from 0.8 s on, is lost at 0.95 s and back at 1.05 s."""
    lost = replace(moving, phase=beat(state=PhaseState.SUSPECT))
    for first in range(0, ticks, every):
        now_s = first / RATE_HZ
        transform = replace(moving, phase=beat(until_s=0.3)) if now_s < 0.5 else lost
        if 0.8 <= now_s < 0.95 or now_s >= 1.05:
            transform = moving
        yield ServoInputs(transform, now_s, TRACKER_FROM_DEVICE), min(every, ticks - first)


@pytest.mark.parametrize("which", [slice(None), slice(2, None)], ids=["walls", "guidance alone"])
def test_a_lost_phase_leaves_walls_and_the_kernel_s_tick_stays_the_readable_one(ball, moving, path_mm, which):
    """Guidance has gone after 250 ms and no step exceeds the slew limit; without a wall the force fades."""
    fixtures = Fixtures(ball, FixtureSet(THREE.fixtures[which], 0.6))
    device = RecordedDevice(path_mm, RATE_HZ)
    servo = SimulatedServo(fixtures, device, limits=LIMITS, options=OPTIONS)
    twin = ReadableTick(fixtures, LIMITS, OPTIONS, device.latency_s)
    rows, tick = [], 0
    for inputs, count in losing_phase(moving, 1450):
        record = servo.run(inputs, count)
        for k in range(count):
            expected = twin.step(float(record.t_s[k]), path_mm[tick], inputs)
            np.testing.assert_allclose(record.sent_n[k], expected.force_n, atol=1e-9)
            assert (record.state[k], record.hazards[k]) == (expected.state, expected.hazards)
            tick += 1
        rows.append(record.rows)
    record = ServoRecord(np.concatenate(rows))
    steps = np.linalg.norm(np.diff(record.sent_n, axis=0), axis=1)
    assert steps.max() <= 0.1
    assert not record.clamped.any()
    gone = record.t_s[(record.hazards & Hazard.NO_PHASE) != 0]
    assert gone[0] == pytest.approx(0.3, abs=0.0011)
    held = slice(600, 790)
    if which == slice(None):
        assert set(record.state.tolist()) == {SupervisorState.DEGRADED, SupervisorState.OK}
        pose = moving.pose
        for k in range(600, 790, 30):
            ahead = record.t_s[k] + 0.5e-3
            walls = Fixtures(ball, FixtureSet(THREE.fixtures[:2], 0.6))
            place = Rigid(ball.frame, "tracker", pose.at(ahead).rotation, pose.at(ahead).translation_mm)
            speed = record.xyz_mm[k : k + 1] - record.xyz_mm[k - 1 : k]
            tip = record.xyz_mm[k : k + 1] + 0.5 * speed
            alone = walls.evaluate(place, tip, np.nan, np.array([int(Status.NO_PHASE)]))
            np.testing.assert_allclose(record.field_n[k], alone.force_n[0], atol=2e-3)
            assert record.distance_mm[k] == pytest.approx(alone.distance_mm[0], abs=0.02)
        assert np.linalg.norm(record.sent_n[held], axis=1).max() > 0.15
    else:
        assert not record.sent_n[held].any()
        assert np.isnan(record.distance_mm[held]).all()


def test_leaving_the_box_while_the_phase_is_lost_is_that_of_the_readable_tick(ball, moving, path_mm):
    """At 0.45 s, within the crossing, and at 0.65 s, for 5 ms each; the force fades and comes back."""
    fixtures, path = Fixtures(ball, THREE), path_mm.copy()
    for begin in (450, 650):
        path[begin : begin + 5] += 500.0
    servo = SimulatedServo(fixtures, RecordedDevice(path, RATE_HZ), limits=LIMITS, options=OPTIONS)
    twin, tick, found = ReadableTick(fixtures, LIMITS, OPTIONS, 0.0), 0, Hazard.NONE
    for inputs, count in losing_phase(moving, 1000):
        record = servo.run(inputs, count)
        for k in range(count):
            expected = twin.step(float(record.t_s[k]), path[tick], inputs)
            np.testing.assert_allclose(record.sent_n[k], expected.force_n, atol=1e-9)
            assert (record.state[k], record.hazards[k]) == (expected.state, expected.hazards)
            found |= expected.hazards
            tick += 1
    assert found & Hazard.OUT_OF_VOLUME
    assert found & Hazard.NO_PHASE


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
    both = field(ball, moving, path_mm, FixtureSet((one, one, guide), 4.0))
    fixtures = Fixtures(ball, FixtureSet((one, one, guide), 4.0))
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


BENT = [[-14.0, 0.0, 3.0], [4.0, 13.0, -2.0], [15.0, 2.0, 4.0]]
BEATING = PathTarget(
    "mr",
    np.array([BENT, np.multiply(BENT, 1.1), np.add(BENT, [0.0, 1.0, 0.5])]),
    CycleTiming(np.array([0.0, 0.3, 0.55]), 0.8),
)
PULL = Gaussian(5.0, 1.0, 0.3)
PATH_SETS = {
    "static path": FixtureSet((FixtureOptions(PULL, path=PathTarget.static("mr", BENT)),)),
    "beating path first": FixtureSet((FixtureOptions(PULL, path=BEATING), *THREE.fixtures), 0.6),
    "two paths behind a wall": FixtureSet(
        (
            THREE.fixtures[0],
            FixtureOptions(PULL, path=PathTarget.static("mr", BENT[:2])),
            FixtureOptions(PULL, path=BEATING),
        ),
        0.6,
    ),
}


ATRIUM = structure("atrium", [20.0, 6.0, 1.0], 6.0)
OESOPHAGUS = structure("oesophagus", [20.0, 2.0, 1.0], 5.0, still=True, margin_mm=1.0)
FAR_AWAY = structure("nerve", [0.0, 60.0, 0.0], 4.0, still=True, margin_mm=8.0)
BY_ATRIUM = PathTarget.beating(ATRIUM, [[14.0, 5.0, 1.0], [15.0, 8.0, 3.0]])
STEEP, SOFT = Sigmoid(6.0, 0.08, 0.0), Sigmoid(1.0, 0.2)
PATH_SETS |= {
    "a wall whose box the tool leaves, guidance on a structure, the heart": FixtureSet(
        (
            FixtureOptions(STEEP, name="oesophagus", structure=OESOPHAGUS),
            FixtureOptions(Gaussian(5.0, 1.0, 0.3), "periodic", structure=ATRIUM),
            FixtureOptions(Sigmoid(1.2, 0.3), "distance", name="wall"),
        ),
        0.6,
    ),
    "no fixture on the heart": FixtureSet(
        (
            FixtureOptions(SOFT, structure=FAR_AWAY),
            FixtureOptions(PULL, path=BY_ATRIUM, structure=ATRIUM),
            FixtureOptions(SOFT, "periodic", structure=ATRIUM),
            FixtureOptions(STEEP, structure=OESOPHAGUS),
        ),
        0.6,
    ),
    "a structure out of reach alone": FixtureSet((FixtureOptions(SOFT, structure=FAR_AWAY),)),
}


@pytest.mark.parametrize("which", PATH_SETS)
def test_paths_and_structures_in_the_kernel_s_tick_are_those_of_the_readable_one(
    ball, moving, path_mm, which
):
    """Static and beating, alone and with walls, through a loss of the phase."""
    fixtures, device = Fixtures(ball, PATH_SETS[which]), RecordedDevice(path_mm, RATE_HZ)
    servo = SimulatedServo(fixtures, device, limits=LIMITS, options=OPTIONS)
    twin, tick, most_n, primaries = ReadableTick(fixtures, LIMITS, OPTIONS, 0.0), 0, 0.0, set()
    for inputs, count in losing_phase(moving, 330 if which.endswith("alone") else 700):
        record = servo.run(inputs, count)
        for k in range(count):
            expected = twin.step(float(record.t_s[k]), path_mm[tick], inputs)
            np.testing.assert_allclose(record.sent_n[k], expected.force_n, atol=1e-9)
            np.testing.assert_allclose(record.distance_mm[k], twin.distance_mm, atol=1e-9)
            assert (record.state[k], record.hazards[k]) == (expected.state, expected.hazards)
            most_n = max(most_n, float(np.linalg.norm(record.sent_n[k])))
            tick += 1
        np.testing.assert_allclose(record.by_surface_mj[-1], twin.observer.by_surface_mj, atol=1e-9)
        if fixtures.options.fixtures[0].structure is OESOPHAGUS:
            primaries |= set((record.distance_mm > -1.5).tolist())
    assert most_n > 0.1 or which == "a structure out of reach alone"
    if fixtures.options.fixtures[0].structure is OESOPHAGUS:
        assert primaries == {True, False}


def test_too_many_fixtures_are_refused(ball):
    device = RecordedDevice(np.zeros((1, 3)), RATE_HZ)
    many = FixtureSet((FixtureOptions(Sigmoid(1.0, 0.1)),) * 9)
    with pytest.raises(InvalidInputError, match="up to 8"):
        SimulatedServo(Fixtures(ball, many), device)


@pytest.mark.parametrize("margin", [[-1.0], [1.0] * 9])
def test_margins_that_cannot_be_are_refused(moving, margin):
    with pytest.raises(InvalidInputError, match="margins"):
        ServoInputs(moving, 0.0, Rigid.identity("tracker", "device"), margin_mm=np.array(margin))
