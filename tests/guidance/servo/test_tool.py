"""Tools that are no point: thickness, shaft, fulcrum; against brute force and virtual work."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from data_synth.operator.fulcrum import Fulcrum as TrueFulcrum
from dvf_ig.core import InvalidInputError, Rigid
from dvf_ig.guidance import (
    Confinement,
    Evaluator,
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Fulcrum,
    Gaussian,
    PathTarget,
    Sigmoid,
    Status,
    Tool,
    force_at_distance,
)
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, SimulatedServo, TrackedServo
from dvf_ig.guidance.supervision.hazards import Hazard
from dvf_ig.intake.fixtures import FixturesConfig
from dvf_ig.kernels.servo import lever
from dvf_ig.kernels.servo.layout import MOST_SAMPLES, new_memory
from dvf_ig.kernels.servo.shaft import BAND_MM, PITCH_MM, wall_on_shaft
from dvf_ig.study.passivity import CELLS, HALF_MM, KNOT_MM, steady_transform, wall_model

DEVICE = Rigid.identity("tracker", "device")
TROCAR = np.array([-20.0, 110.0, -30.0])
LENGTH_MM = 300.0
FULCRUM = Fulcrum(TROCAR, LENGTH_MM)
PHASE = 0.2


def wavy_wall(crest_mm=3.0, apart_mm=30.0):
    """The organ is x > −crest·cos²(π y/apart): crests that reach towards the tool, `apart_mm` apart."""
    model = wall_model(0.0, phases=2)
    y = KNOT_MM * (np.arange(CELLS + 3) - 1.0) - HALF_MM
    rise = crest_mm * np.cos(np.pi * y / apart_mm) ** 2
    return replace(model, coefficients=(model.coefficients + rise[:, None]).astype(np.float32))


def unit(v):
    return np.asarray(v, dtype=float) / np.linalg.norm(v)


def on_shaft(model, law, tool, tip, axis, inside_mm=np.inf):
    """Force as at the tip, distance, gradient, and how far above the tip the wall is met."""
    evaluator = Evaluator(model, law)
    coefficients, packed = evaluator.kernel_arguments(Rigid.identity(model.frame, model.frame))[:2]
    shape, depths = tool.packed(in_hand=False, inward=1.0)[0], np.zeros(MOST_SAMPLES)
    warps = np.zeros((2, 4, 4, 16), dtype=np.float32)
    through = (warps, steady_transform(model).packed[0], 0.0)
    place, along = tuple(tip.tolist()), tuple(axis.tolist())
    output, met = wall_on_shaft(coefficients, packed, shape, place, along, inside_mm, PHASE, through, depths)
    return output, met


def brute(model, law, tool, tip, axis):
    """Samples every 0.02 mm along the shaft, and where the deepest is."""
    s = np.arange(0.0, tool.shaft_mm + 0.01, 0.02)
    samples = Evaluator(model, law).force(tip + s[:, None] * axis, PHASE)
    return samples, s, int(np.nanargmax(samples.distance_mm))


def test_the_deepest_place_of_a_shaft_is_that_of_brute_force(ball):
    """Beside a ball, whose far side the shaft never reaches: within pitch²/(8R) of the depth."""
    rng, law, worst = np.random.default_rng(5), Sigmoid(1.0), 0.0
    for _ in range(120):
        axis, tip = unit(rng.standard_normal(3)), rng.uniform(-24.0, 24.0, 3)
        tool = Tool(shaft_mm=float(rng.uniform(3.0, 40.0)), axis=axis)
        samples, s, at = brute(ball, law, tool, tip, axis)
        (status, force, distance, gradient, _), met = on_shaft(ball, law, tool, tip, axis)
        if not np.isfinite(samples.distance_mm[at]):
            assert status == Status.OUT_OF_VOLUME
            continue
        deepest = float(samples.distance_mm[at])
        if not -6.0 < deepest < 3.0:
            continue  # further out the box ends, further in distances have ridges
        radius_mm = 13.0 - deepest
        worst = max(worst, deepest - distance)
        assert deepest - PITCH_MM**2 / (8.0 * radius_mm) - BAND_MM <= distance <= deepest + 0.02
        if samples.force_n[at].any() and tool.shaft_mm > PITCH_MM:
            cosine = unit(force) @ unit(samples.force_n[at])
            assert cosine > 0.8
        assert abs(met - s[at]) < 2.0 * PITCH_MM
        assert np.linalg.norm(gradient) < 1.2
    assert worst > 0.01


def test_a_shaft_along_the_wall_meets_it_as_a_point_does_where_it_is_deepest():
    """On a flat wall the end that reaches in is deepest, and the force is exactly that of this point."""
    model, law, axis = wall_model(5.0), Sigmoid(1.0), unit([0.3, 0.9, 0.2])
    tool, tip = Tool(shaft_mm=30.0, axis=axis), np.array([-9.0, -10.0, 0.0])
    (_, force, distance, _, rate), met = on_shaft(model, law, tool, tip, axis)
    alone = Evaluator(model, law).force((tip + 30.0 * axis)[None], PHASE)
    assert met == pytest.approx(30.0)
    np.testing.assert_allclose(force, alone.force_n[0], atol=1e-9)
    assert distance == pytest.approx(alone.distance_mm[0], abs=1e-5)
    assert rate == pytest.approx(alone.rate_mm_per_cycle[0], rel=1e-5)


def test_the_force_does_not_jump_where_the_deepest_place_does():
    """Tilted over two crests the deepest place jumps by 30 mm; half the tilt halves every change of force."""
    model, law = wavy_wall(), Sigmoid(1.0, 0.6)
    middle, tool = np.array([-2.0, 0.0, 0.0]), Tool(shaft_mm=60.0, axis=np.array([0.0, 1.0, 0.0]))

    def changes(step_rad):
        met, forces = [], []
        for angle in np.arange(-0.02, 0.02, step_rad):
            axis = np.array([np.sin(angle), np.cos(angle), 0.0])
            output, at = on_shaft(model, law, tool, middle - 30.0 * axis, axis)
            assert output[0] == Status.OK
            met.append(at)
            forces.append(output[1])
        return np.array(met), np.linalg.norm(np.diff(forces, axis=0), axis=1)

    met, coarse = changes(4e-4)
    assert np.ptp(met) > 25.0
    _, fine = changes(2e-4)
    assert coarse.max() < 0.02
    assert fine.max() < 0.6 * coarse.max()


def test_through_a_trocar_the_force_on_the_tip_does_the_work_of_that_on_the_shaft():
    """F_tip·dx_tip = F_shaft·dx_shaft for every turn about the trocar."""
    model, law, tip = wall_model(0.0), Sigmoid(0.25), np.array([-12.0, -25.0, 5.0])
    trocar = np.array([15.0, 70.0, 20.0])
    inside = float(np.linalg.norm(trocar - tip))
    axis, tool = (trocar - tip) / inside, Tool(shaft_mm=35.0, fulcrum=Fulcrum(trocar, 250.0))
    (_, force, _, _, _), met = on_shaft(model, law, tool, tip, axis, inside)
    assert met == pytest.approx(35.0)

    def on_axis(moved):
        return trocar + (1.0 - met / float(np.linalg.norm(trocar - moved))) * (moved - trocar)

    there = Evaluator(model, law).force(on_axis(tip)[None], PHASE).force_n[0]
    jacobian = np.array([approx_fprime(tip, component, 1e-5, on_axis, k) for k in range(3)])
    np.testing.assert_allclose(force, jacobian.T @ there, atol=1e-6)


def component(place, function, k):
    return function(place)[k]


def test_the_lever_is_that_of_virtual_work():
    """tip(hand) is the synthetic instrument's; F_hand·dx_hand = F_tip·dx_tip by finite differences."""
    rng, true = np.random.default_rng(2), TrueFulcrum(TROCAR, LENGTH_MM)
    shape = Tool(fulcrum=FULCRUM).packed(in_hand=True, inward=1.0)[0]
    for _ in range(20):
        hand = TROCAR + rng.uniform(70.0, 270.0) * unit(rng.standard_normal(3))
        memory, tip = new_memory()[0], hand.copy()
        lever.tip_of_hand(memory, shape, tip)
        np.testing.assert_allclose(tip, true.tip(hand), atol=1e-9)
        np.testing.assert_allclose(FULCRUM.other_end_mm(tip), hand, atol=1e-9)
        np.testing.assert_allclose(FULCRUM.other_end_mm(hand), tip, atol=1e-9)
        assert memory["lever"] == pytest.approx(true.lever(tip))
        at_tip = rng.standard_normal(3)
        at_hand, back = at_tip.copy(), np.zeros(3)
        lever.force_on_hand(memory, at_hand)
        jacobian = np.array([approx_fprime(hand, component, 1e-5, true.tip, k) for k in range(3)])
        np.testing.assert_allclose(at_hand, jacobian.T @ at_tip, atol=1e-5)
        lever.force_on_tip(memory, at_hand, back)
        np.testing.assert_allclose(back, at_tip, atol=1e-12)


WALL = (FixtureOptions(Sigmoid(1.0)),)


def servo_on(path_mm, tool, *, fixtures=WALL, model=None, axis=None):
    """Device and record of a servo whose device, frame "tracker", goes along a path at 1 kHz."""
    of = wall_model(5.0) if model is None else model
    device = RecordedDevice(path_mm, 1000.0)
    servo = SimulatedServo(Fixtures(of, FixtureSet(fixtures, tool=tool)), device, options=ServoOptions())
    axis = np.zeros(3) if axis is None else axis
    inputs = ServoInputs(steady_transform(of), 0.0, DEVICE, tool_axis=axis, valid_for_s=60.0)
    return device, servo.run(inputs, len(path_mm))


def pushing(ticks=900):
    """(n, 3) tip on its way into the wall and along it."""
    t = np.arange(ticks) / 1000.0
    return np.stack([-3.0 + 4.0 * np.sin(2.0 * t), 10.0 * t, 3.0 * t], axis=1)


def test_through_a_fulcrum_the_hand_feels_what_the_tip_meets(ball):
    """Inverted and scaled by the lever, softened where the tip moves further, the same work as at the tip."""
    tips = pushing()
    hands = np.array([FULCRUM.other_end_mm(tip) for tip in tips])
    device, record = servo_on(hands, Tool(fulcrum=FULCRUM))
    _, alone = servo_on(tips, Tool())
    np.testing.assert_allclose(record.xyz_mm, tips, atol=1e-9)
    inside = np.linalg.norm(TROCAR - tips, axis=1)
    ratio = inside / (LENGTH_MM - inside)
    soft = 1.0 / np.maximum(1.0, ratio) ** 2
    np.testing.assert_allclose(record.field_n, soft[:, None] * alone.field_n, atol=1e-9)
    k = 700
    across = unit(np.cross(TROCAR - tips[k], [0.0, 0.0, 1.0]))
    inverted = record.wanted_n[k] @ across / (soft[k] * (alone.wanted_n[k] @ across))
    assert inverted == pytest.approx(-ratio[k], rel=1e-3)
    moved = np.diff(hands, axis=0)
    work = (device.force_n[:-1] * moved).sum()
    assert record.given_mj[-1] == pytest.approx(work, rel=0.01)
    assert np.linalg.norm(record.sent_n, axis=1).max() <= 0.6 + 1e-9


def test_a_tip_that_leaves_the_body_has_no_force():
    """With the hand further from the trocar than the instrument is long nothing is rendered."""
    tip = TROCAR + np.array([0.0, 6.0, 0.0])
    hand = TROCAR + np.array([0.0, LENGTH_MM + 6.0, 0.0])
    _, record = servo_on(np.tile(hand, (50, 1)), Tool(fulcrum=FULCRUM))
    np.testing.assert_allclose(record.xyz_mm[-1], tip, atol=1e-9)
    assert (record.status == Status.OUT_OF_VOLUME).all()
    assert not record.sent_n.any()


def test_the_servo_keeps_the_whole_shaft_out(ball):
    """The end of the shaft is in the wall; free, through a trocar, and without an axis."""
    axis, tip = unit([0.4, 0.9, 0.0]), np.array([-10.0, -5.0, 0.0])
    tips = np.tile(tip, (600, 1))
    tool = Tool(shaft_mm=30.0, axis=axis)
    _, record = servo_on(tips, tool, axis=axis)
    expected = Evaluator(wall_model(5.0), Sigmoid(1.0)).force(tip[None] + 30.0 * axis, (0.5995 / 0.6) % 1.0)
    np.testing.assert_allclose(record.field_n[-1], expected.force_n[0], atol=1e-3)
    assert record.distance_mm[-1] == pytest.approx(expected.distance_mm[0], abs=0.05)
    _, unknown = servo_on(tips, tool)
    assert (unknown.status == Status.STALE_TOOL).all()
    assert not unknown.sent_n.any()
    trocar = tip + 60.0 * axis
    through = Tool(shaft_mm=30.0, fulcrum=Fulcrum(trocar, 200.0))
    servo = TrackedServo(Fixtures(wall_model(5.0), FixtureSet((FixtureOptions(Sigmoid(1.0)),), tool=through)))
    transform = steady_transform(wall_model(5.0))
    ticks = [
        servo.step(0.01 * k, transform, Hazard.NONE, Status.OK, np.zeros(0), (tip, np.zeros(3)))
        for k in range(61)
    ]
    assert np.linalg.norm(ticks[-1].wanted_n) > 0.1


@pytest.mark.parametrize(
    "law",
    [Sigmoid(1.0, depth_mm=1.0), Gaussian(3.0), Confinement(1.0, depth_mm=-1.0)],
    ids=lambda law: type(law).__name__,
)
def test_a_thick_tool_acts_at_its_surface(law):
    """A law for a tool of 4 mm is that of a point 2 mm deeper, or in a chamber 2 mm nearer to its wall."""
    model, tool = wall_model(5.0), Tool(diameter_mm=4.0)
    inward = np.array([-2.0 if isinstance(law, Confinement) else 2.0, 0.0, 0.0])
    options = FixtureSet((FixtureOptions(law),), tool=tool)
    thick, thin = Fixtures(model, options), Fixtures(model, FixtureSet((FixtureOptions(law),)))
    here = Rigid.identity("mr", "mr")
    places = pushing()[::50]
    np.testing.assert_allclose(
        thick.evaluate(here, places, PHASE).force_n,
        thin.evaluate(here, places + inward, PHASE).force_n,
        atol=1e-6,
    )
    samples = thin.evaluate(here, places, PHASE)
    by_distance = force_at_distance(options, samples.distance_mm, samples.gradient)
    np.testing.assert_allclose(by_distance, thick.evaluate(here, places, PHASE).force_n, atol=1e-5)
    _, record = servo_on(pushing(), tool, fixtures=(FixtureOptions(law),))
    _, alone = servo_on(pushing() + inward, Tool(), fixtures=(FixtureOptions(law),))
    np.testing.assert_allclose(record.field_n, alone.field_n, atol=1e-6)
    np.testing.assert_allclose(record.distance_mm, alone.distance_mm, atol=1e-5)


def test_a_path_guides_the_centre_of_a_thick_tip():
    path = PathTarget.static("mr", [[-5.0, -20.0, 0.0], [-5.0, 20.0, 0.0]])
    fixture = FixtureOptions(Gaussian(3.0), path=path)
    _, thick = servo_on(pushing(), Tool(diameter_mm=4.0), fixtures=(fixture,))
    _, thin = servo_on(pushing(), Tool(), fixtures=(fixture,))
    np.testing.assert_array_equal(thick.rows["field_n"], thin.rows["field_n"])
    np.testing.assert_array_equal(thick.distance_mm, thin.distance_mm)


def test_tools_that_cannot_be_are_refused():
    for message, arguments in {
        "diameter is -1 mm": {"diameter_mm": -1.0},
        "shaft is 900 mm": {"shaft_mm": 900.0, "fulcrum": FULCRUM},
        "direction of the tool's shaft": {"shaft_mm": 10.0},
        "axis of the tool is zero": {"axis": np.zeros(3)},
    }.items():
        with pytest.raises(InvalidInputError, match=message):
            Tool(**arguments)
    with pytest.raises(InvalidInputError, match="hand to tip"):
        Fulcrum(TROCAR, 2.0)
    with pytest.raises(InvalidInputError, match="does not state where its shaft points"):
        Tool(shaft_mm=10.0, axis=np.ones(3)).require_device("the Omni")
    Tool(shaft_mm=10.0, fulcrum=FULCRUM).require_device("the Omni")


def test_a_tool_is_described_as_it_is_read():
    tool = Tool(5.0, 60.0, np.array([0.0, 0.0, -2.0]), FULCRUM)
    config = FixturesConfig.of(FixtureSet(tool=tool))
    assert config.tool is not None
    read = config.tool.shape()
    assert read.fulcrum is not None
    assert (read.diameter_mm, read.shaft_mm, read.fulcrum.length_mm) == (5.0, 60.0, LENGTH_MM)
    np.testing.assert_array_equal(read.axis, [0.0, 0.0, -1.0])
    np.testing.assert_array_equal(read.fulcrum.point_mm, TROCAR)
    assert FixturesConfig.of(FixtureSet()).tool is None


@pytest.mark.parametrize(
    ("tool", "expected"),
    [
        (Tool(), [0.6, 0.0, 0.8]),
        (Tool(5.0, 60.0, np.array([0.0, 2.0, 0.0])), [-1.0, 0.0, 0.0]),
        (Tool(5.0, 60.0, fulcrum=Fulcrum(np.array([0.0, 20.0, 3.0]), LENGTH_MM)), [0.0, 1.0, 0.0]),
    ],
)
def test_a_shaft_is_drawn_towards_sensor_axis_or_fulcrum(tool: Tool, expected: list[float]) -> None:
    """The tool is turned by 90° about z: its x is the tracker's y, its y the tracker's −x."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    tip_mm, at = np.array([0.0, 60.0, -80.0]), np.array([[0.0, 10.0, 3.0]])
    np.testing.assert_allclose(tool.handle_direction(tip_mm, at, turn[None])[0], expected, atol=1e-12)
    alone = Tool().handle_direction(np.zeros(3), at, turn[None])[0]
    np.testing.assert_allclose(alone, [0.0, 0.0, 1.0])
