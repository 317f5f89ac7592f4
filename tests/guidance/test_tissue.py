"""Forces of tissue on a hand at the servo, and which properties a device renders."""

from dataclasses import replace

import numpy as np
import pytest

from dvf_ig.core import DvfModel, FloatArray, InvalidInputError, Rigid, Warp, WarpMotion
from dvf_ig.core.space.warp import CELLS, knots
from dvf_ig.guidance import DEVICES, DeviceLimits, PoseAndPhase
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.devices.simulated import SimulatedStylus
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, ServoRecord, SimulatedServo
from dvf_ig.guidance.tissue import TISSUES, class_of, feel_fixtures, feel_of
from dvf_ig.study.passivity import steady_transform
from dvf_ig.study.tissue import tissue_wall

SMOOTH = DeviceLimits()
SLOW_TICKS = 700
"""Ticks in which the force has risen."""


def felt(
    model: DvfModel, xyz_mm: FloatArray, limits: DeviceLimits = SMOOTH, warp: WarpMotion | None = None
) -> ServoRecord:
    """The record of a tip on a path, a millisecond a sample, after it has waited at its first place."""
    path = np.concatenate([np.tile(xyz_mm[0], (SLOW_TICKS, 1)), xyz_mm])
    device = RecordedDevice(path, 1000.0)
    options = ServoOptions(feel=feel_of(model, limits), predict_tool=False)
    servo = SimulatedServo(feel_fixtures(model, limits), device, limits=limits, options=options)
    steady = steady_transform(model)
    transform = PoseAndPhase(steady.pose, steady.phase, steady.retiming, np.eye(6), warp=warp)
    inputs = ServoInputs(transform, 0.0, Rigid.identity("tracker", "device"), valid_for_s=60.0)
    return ServoRecord(servo.run(inputs, len(path)).rows[SLOW_TICKS:])


def stay(x_mm: float, y_mm: float, ticks: int = 20) -> FloatArray:
    return np.tile([x_mm, y_mm, 0.0], (ticks, 1))


def kind(name: str) -> float:
    return next(one.stiffness_n_per_mm for one in TISSUES if one.name == name)


def test_each_label_has_its_stiffness_and_none_is_felt_outside() -> None:
    model = tissue_wall(["atrial wall", "vessel wall"])
    for y_mm, name in ((-15.0, "atrial wall"), (15.0, "great vessel")):
        rows = felt(model, stay(2.0, y_mm))
        # at rest there is no damping, and the smooth classes have no texture
        np.testing.assert_allclose(rows.field_n[-1], [-2.0 * kind(name), 0.0, 0.0], atol=1e-6)
        np.testing.assert_allclose(rows.sent_n[-1], rows.field_n[-1], atol=1e-6)
        assert not felt(model, stay(-0.1, y_mm)).sent_n.any()


def test_friction_holds_then_slides_at_its_share_of_the_normal_force() -> None:
    model = tissue_wall(["vessel wall"])
    slide = stay(2.0, 0.0, 400)
    slide[:, 1] = 0.01 * np.arange(400)
    force = felt(model, slide).field_n
    normal_n, friction = 2.0 * kind("great vessel"), 0.05
    np.testing.assert_allclose(force[-1], [-normal_n, -friction * normal_n, 0.0], atol=1e-6)
    assert 0.0 > force[3, 1] > 0.9 * force[-1, 1]
    assert np.linalg.norm(force[:, 1:], axis=1).max() <= friction * normal_n + 1e-6


def test_a_tool_at_rest_is_dragged_by_tissue_that_moves_sideways() -> None:
    model = tissue_wall(["vessel wall"])
    assert model.tissue is not None
    first = model.tissue.motion[0]
    sideways = 3.0 * np.sin(2.0 * np.pi * np.arange(model.phases) / model.phases)
    motion = []
    for shift_mm in sideways.tolist():
        coefficients = first.coefficients.copy()
        coefficients[..., 1] = shift_mm
        motion.append(replace(first, coefficients=coefficients))
    moving = replace(model, tissue=replace(model.tissue, motion=tuple(motion)))
    force = felt(moving, stay(2.0, 0.0, 600)).field_n[:, 1]
    largest_n = 0.05 * 2.0 * kind("great vessel")
    assert force.max() == pytest.approx(largest_n, rel=1e-6)
    assert force.min() == pytest.approx(-largest_n, rel=1e-6)


def test_texture_is_carried_with_the_material() -> None:
    model = tissue_wall(["fat"])
    along = stay(2.0, 0.0, 600)
    along[:, 1] = 0.01 * np.arange(600)
    normal_n = -felt(model, along).field_n[:, 0] / (2.0 * kind("fat"))
    # two periods of 3 mm along y, a third of the amplitude each axis
    np.testing.assert_allclose(normal_n[:300], normal_n[300:], atol=1e-3)
    assert np.ptp(normal_n) == pytest.approx(2.0 * 0.2 / 3.0, rel=0.01)


def test_it_pushes_against_approach_and_never_pulls() -> None:
    model = tissue_wall(["vessel wall"])
    path = stay(2.0, 0.0, 100)
    path[50:, 0] -= 0.2 * np.arange(50)
    force = felt(model, path).field_n[:, 0]
    assert force.max() <= 0.0
    path[50:, 0] = 2.0 + 0.02 * np.arange(50)
    pressed = felt(model, path).field_n[60, 0]
    assert pressed < -kind("great vessel") * path[60, 0]


def test_a_changed_shape_moves_the_tissue() -> None:
    model = tissue_wall(["atrial wall", "vessel wall"])
    low = np.full(3, -36.0)
    places = knots(low, 6.0)
    shift = np.tile([1.0, -12.0, 0.0], (len(places), 1))
    shift[:, 0] += 0.1 * places[:, 0]
    warp = WarpMotion.still(Warp.through("mr", low, 72.0 / CELLS, shift, np.full(len(places), 0.5)))
    rows = felt(model, stay(3.0, -5.0), warp=warp)
    # the surface lies where 0.9 x = 1
    depth_mm = 3.0 - 1.0 / 0.9
    np.testing.assert_allclose(rows.field_n[-1], [-depth_mm * kind("great vessel"), 0.0, 0.0], atol=1e-4)


def test_a_device_is_told_by_name_what_it_cannot_render() -> None:
    model = tissue_wall(["myocardium", "scar", "liver"])
    stylus = SimulatedStylus(DEVICES["omni"], np.zeros(3))
    feel = feel_of(model, stylus.limits)
    assert [one.name for one in feel.classes] == ["myocardium", "scar", "liver"]
    assert any("liver cannot be distinguished from scar by stiffness" in one for one in feel.refused)
    assert not any("scar cannot be distinguished from myocardium" in one for one in feel.refused)
    assert any("friction of myocardium cannot be rendered" in one and "Omni" in one for one in feel.refused)
    assert not feel.properties[..., 2:].any()
    soft = replace(stylus.limits, stiffness_n_per_m=50.0)
    assert any("renders scar with 0.05" in one for one in feel_of(model, soft).refused)


def test_labels_are_found_by_name() -> None:
    names = ("lv_myocardium", "RV wall", "la_blood", "vessel_wall", "atrial_wall", "label 7", "Infarct core")
    kinds = [None if (one := class_of(name)) is None else one.name for name in names]
    expected = ["myocardium", "right ventricular wall", None, "great vessel", "atrial wall", None, "scar"]
    assert kinds == expected
    for model, sentence in (
        (replace(tissue_wall(["fat"]), tissue=None), "keeps no labels"),
        (tissue_wall(["a", "b"]), "no label of the model is named"),
    ):
        with pytest.raises(InvalidInputError, match=sentence):
            feel_of(model, SMOOTH)


def test_every_value_has_a_source() -> None:
    for one in TISSUES:
        assert len(one.sources) == 4
        assert all(one.sources)
    stiffness = [one.stiffness_n_per_mm for one in TISSUES]
    assert stiffness == sorted(stiffness)
