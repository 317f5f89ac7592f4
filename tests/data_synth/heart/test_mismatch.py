"""The non-rigid mismatch: exact size, no rigid part, invertible."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_synth.heart.mismatch import SurgicalChange, random_mismatch, surgical_field, tabulated_inverse
from data_synth.kernels.waves import cosine_and_sine
from dvf_ig.core import FloatArray, InvalidInputError

BOX = np.array([[-60.0, -100.0, -40.0], [70.0, 35.0, 85.0]])


def box_nodes(per_axis: int = 24) -> FloatArray:
    middle = (np.arange(per_axis) + 0.5) / per_axis
    axes = [BOX[0, k] + middle * (BOX[1, k] - BOX[0, k]) for k in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


@given(rms=st.floats(0.1, 5.0), seed=st.integers(0, 1000))
@settings(max_examples=25)
def test_rms_is_as_asked_and_no_rigid_motion_is_left(rms: float, seed: int) -> None:
    field = random_mismatch(BOX, rms, np.random.default_rng(seed))
    nodes = box_nodes()
    moved = field.at(nodes)
    # another grid than the one it was scaled on: 1 % is the discretisation of a 30 mm field
    assert np.sqrt((moved**2).sum(axis=1).mean()) == pytest.approx(rms, rel=0.01)
    assert np.linalg.norm(moved.mean(axis=0)) < 0.02 * rms
    centred = nodes - nodes.mean(axis=0)
    u, _, vt = np.linalg.svd(centred.T @ (centred + moved - moved.mean(axis=0)))
    rotation = vt.T @ u.T
    angle = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
    assert angle * 65.0 < 0.03 * rms + 1e-3


@given(seed=st.integers(0, 1000))
@settings(max_examples=25)
def test_inverse_undoes_forward(seed: int) -> None:
    field = random_mismatch(BOX, 5.0, np.random.default_rng(seed))
    nodes = box_nodes(6)
    assert np.abs(field.inverse(field.forward(nodes)) - nodes).max() < 1e-3


@given(seed=st.integers(0, 1000))
@settings(max_examples=3)
def test_tabulated_inverse_is_as_good(seed: int) -> None:
    field = random_mismatch(BOX, 5.0, np.random.default_rng(seed))
    table = tabulated_inverse(field, BOX)
    points = np.random.default_rng(seed).uniform(*BOX, (2000, 3))
    assert np.linalg.norm(field.forward(table.at(points)) - points, axis=1).max() < 0.03


def test_field_is_the_sum_of_its_waves() -> None:
    """The kernel against plain NumPy."""
    field = random_mismatch(BOX, 2.0, np.random.default_rng(3))
    relative = box_nodes(5) - field.center_mm
    angle = relative @ field.waves.T
    expected = np.cos(angle) @ field.cosine + np.sin(angle) @ field.sine
    expected -= field.shift_mm + np.cross(field.turn_rad, relative)
    assert np.abs(field.at(box_nodes(5)) - expected).max() < 1e-10


def test_cosine_and_sine_of_any_angle() -> None:
    angles = np.concatenate([np.linspace(-20.0, 20.0, 4001), [-1e6, 1e6, 12345.678]])
    found = np.array([cosine_and_sine(angle) for angle in angles])
    np.testing.assert_allclose(found, np.column_stack([np.cos(angles), np.sin(angles)]), rtol=0, atol=1e-14)


def test_zero_mismatch_moves_nothing() -> None:
    field = random_mismatch(BOX, 0.0, np.random.default_rng(0))
    assert not field.at(box_nodes(4)).any()


@pytest.mark.parametrize("rms", [-1.0, 20.0, float("nan")])
def test_impossible_sizes_are_refused(rms: float) -> None:
    with pytest.raises(InvalidInputError, match="needed 0 to 8 mm"):
        random_mismatch(BOX, rms, np.random.default_rng(0))


def test_surgery_presses_the_free_wall_in_without_moving_the_heart() -> None:
    """The planted pose stays the best rigid one; the wall under the retractor goes in, the others out."""
    rng = np.random.default_rng(4)
    outward = rng.normal(size=(4000, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    center, half = BOX.mean(axis=0), 0.5 * np.ptp(BOX, axis=0)
    wall = center + half * outward
    change = SurgicalChange(retraction_mm=8.0, load_mm=2.5)
    surgery = surgical_field(wall, change, np.random.default_rng(5))
    assert surgery is not None
    field = random_mismatch(BOX, 0.0, np.random.default_rng(3), surgery=surgery)
    nodes = box_nodes()
    moved = field.at(nodes)
    assert np.linalg.norm(moved.mean(axis=0)) < 0.03
    assert np.linalg.norm(np.cross(nodes - center, moved).mean(axis=0)) < 3.0, (
        "mm²: less than 0.02 of a mm turn"
    )
    assert field.rms_mm == pytest.approx(np.sqrt((moved**2).sum(axis=1).mean()), rel=0.01)
    out_mm = np.einsum("ij,ij->i", field.at(wall), outward)
    pressed = np.linalg.norm(wall - center - surgery.pressed_mm, axis=1)
    assert out_mm[pressed < 12.0].mean() < -2.5
    assert out_mm[pressed > 60.0].mean() > 1.5
    assert np.abs(field.inverse(field.forward(nodes)) - nodes).max() < 1e-3
    plain = random_mismatch(BOX, 2.0, np.random.default_rng(3))
    both = random_mismatch(BOX, 2.0, np.random.default_rng(3), surgery=surgery)
    np.testing.assert_allclose(both.at(nodes) - plain.at(nodes), moved, atol=1e-9)
    assert surgical_field(wall, SurgicalChange(), rng) is None
    with pytest.raises(InvalidInputError, match="fold space"):
        SurgicalChange(retraction_mm=20.0)
