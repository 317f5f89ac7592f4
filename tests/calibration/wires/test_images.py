"""Dots found in images and named as the wires of N patterns: synthetic dots and planes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_synth.phantoms.nwire import fcal_phantom, wire_crossings_px
from dvf_ig.calibration import RejectedFrame, Rejection
from dvf_ig.calibration.wires.dots import Dots, find_dots
from dvf_ig.calibration.wires.pattern import FoundWires, find_wires
from dvf_ig.calibration.wires.plan import plan_wires
from dvf_ig.core import FloatArray, InvalidInputError, NWirePhantom, Wire

SPACING = 0.078
PIXEL_MM = np.array([0.081, 0.075])
CENTER_PX = np.array([400.0, 300.0])


def blobs(
    points: FloatArray, sd_px: tuple[float, float], shape: tuple[int, int], peak: float = 200.0
) -> NDArray[np.uint8]:
    """Gaussian dots, SD along columns and rows, on black."""
    row, column = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for x, y in points:
        image += peak * np.exp(-0.5 * (((column - x) / sd_px[0]) ** 2 + ((row - y) / sd_px[1]) ** 2))
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def crossings(tilt_rad: FloatArray, shift_mm: FloatArray, phantom: NWirePhantom) -> FloatArray:
    """(wires, 2) px where an image plane, so many radians off across the wires, meets them."""
    facing = Rotation.from_matrix([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    rotation = (facing * Rotation.from_rotvec(tilt_rad)).as_matrix()
    phantom_from_image = np.eye(4)
    phantom_from_image[:3, :3] = rotation * [*PIXEL_MM, 1.0]
    middle = np.array([45.0, 20.0, 10.0]) + shift_mm
    phantom_from_image[:3, 3] = middle - phantom_from_image[:3, :2] @ CENTER_PX
    return wire_crossings_px(phantom, phantom_from_image)[0]


def square_phantom() -> NWirePhantom:
    """Two patterns whose outer wires form a rectangle: no image can tell its ends apart."""
    rows = [
        (
            Wire(f"a{z}", np.array([0.0, 0, z]), np.array([0.0, 40, z])),
            Wire(f"b{z}", np.array([a, 0.0, z]), np.array([b, 40.0, z])),
            Wire(f"c{z}", np.array([30.0, 0, z]), np.array([30.0, 40, z])),
        )
        for z, a, b in ((0.0, 5.0, 25.0), (-15.0, 25.0, 5.0))
    ]
    return NWirePhantom(tuple(rows))


@pytest.mark.parametrize("spacing", [0.08, 0.5])
def test_dots_are_found_where_they_were_drawn(spacing: float) -> None:
    points = np.array([[60.3, 50.8], [150.6, 41.2], [100.2, 120.7]])
    sd_px = (max(2.0, 0.7 / spacing), max(1.5, 0.3 / spacing))
    found = find_dots(blobs(points, sd_px, (170, 220)), spacing)
    assert len(found) == 3
    nearest = np.linalg.norm(points[:, None] - found.points_px[None], axis=2).min(axis=1)
    assert nearest.max() < 0.1
    clipped = find_dots(blobs(points, sd_px, (170, 220)), spacing, clip=(20, 15, 180, 75))
    assert sorted(clipped.points_px[:, 0].round().tolist()) == [60.0, 151.0]


def test_two_echoes_that_touch_keep_their_own_centres() -> None:
    points = np.array([[60.0, 60.0], [74.0, 62.0]])
    found = find_dots(blobs(points, (5.0, 2.5), (120, 140)), 0.3)
    assert len(found) == 2
    nearest = np.linalg.norm(points[:, None] - found.points_px[None], axis=2).min(axis=1)
    assert nearest.max() < 1.0


def test_a_clip_outside_the_image_and_a_pixel_without_size_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="must lie in the image of 60 x 50 px"):
        find_dots(np.zeros((50, 60), dtype=np.uint8), 0.1, clip=(20, 0, 50, 50))
    with pytest.raises(InvalidInputError, match="must be positive"):
        find_dots(np.zeros((50, 60), dtype=np.uint8), 0.0)


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), across=st.sampled_from([1, -1]), down=st.sampled_from([1, -1]))
def test_wires_of_any_tilted_plane_are_named_right(seed: int, across: int, down: int) -> None:
    rng = np.random.default_rng(seed)
    wires = crossings(rng.uniform(-0.3, 0.3, 3), rng.uniform((-3, -3, -3), (3, 3, 3)), fcal_phantom())
    # an image may be stored mirrored either way; three stray dots, dimmer than the wires
    wires = CENTER_PX + (wires - CENTER_PX) * (across, down)
    stray = CENTER_PX + rng.uniform(-250, 250, (3, 2))
    order = rng.permutation(12)
    dots = Dots(np.vstack([wires, stray])[order], np.repeat([20.0, 4.0], [9, 3])[order])
    found = find_wires(dots, plan_wires(fcal_phantom()), SPACING)
    assert isinstance(found, FoundWires)
    assert np.array_equal(found.points_px, wires)
    assert found.labelling == (-across, down)
    assert found.misfit_mm < 0.6  # pixels that are not square, taken as square


def test_outer_wires_that_look_alike_are_named_by_the_orientation() -> None:
    phantom = square_phantom()
    wires = CENTER_PX + (crossings(np.zeros(3), np.zeros(3), phantom) - CENTER_PX) * 1.0
    dots = Dots(wires, np.full(6, 20.0))
    for orientation, first_is_right in (("MFA", True), ("UFA", False), ("XX", True)):
        plan = plan_wires(phantom, orientation)
        assert len(plan.labellings) == 1
        found = find_wires(dots, plan, SPACING)
        assert isinstance(found, FoundWires)
        assert (found.points_px[0, 0] > found.points_px[2, 0]) == first_is_right
        assert found.points_px[0, 1] < found.points_px[3, 1]
    upside_down = find_wires(dots, plan_wires(phantom, "MN"), SPACING)
    assert isinstance(upside_down, FoundWires)
    assert upside_down.points_px[0, 1] > upside_down.points_px[3, 1]


def refusal(points: FloatArray) -> RejectedFrame:
    found = find_wires(Dots(points, np.full(len(points), 20.0)), plan_wires(fcal_phantom()), SPACING)
    assert isinstance(found, RejectedFrame)
    return found


def test_every_refusal_says_what_was_seen() -> None:
    wires = crossings(np.zeros(3), np.zeros(3), fcal_phantom())
    few = refusal(wires[:6])
    assert few.reason is Rejection.TOO_FEW_DOTS
    assert few.detail == "9 wires expected, 6 dots found on 2 lines"
    corner = np.random.default_rng(0).uniform(0, 40, (12, 2))
    assert refusal(corner) == RejectedFrame(Rejection.NO_LINE, "no line of three dots among 12")
    aside = np.array([[790.0, 590], [792, 560], [788, 540]])
    apart = refusal(np.vstack([wires[:6], aside]))
    assert apart == RejectedFrame(Rejection.LINES_APART, "3 lines expected, 9 dots form 2 lines")
    far = wires.copy()
    far[6:, 1] += 4.0 / SPACING
    assert refusal(far).reason is Rejection.LINES_APART
    bent = wires.copy()
    bent[[0, 8], 0] += [2.4 / SPACING, 2.4 / SPACING]
    assert refusal(bent).reason is Rejection.MISFIT
    slid = wires.copy()
    # met 2, 20 and 38 mm along the wires, 10 mm below each other
    slid[[1, 4, 7], 0] = CENTER_PX[0] + np.array([9.0, 0.0, -4.25]) / PIXEL_MM[0]
    assert refusal(slid).reason is Rejection.STEEP


def test_phantoms_that_give_no_plan_are_refused() -> None:
    patterns = fcal_phantom().patterns
    with pytest.raises(InvalidInputError, match="at least two"):
        plan_wires(NWirePhantom(patterns[:1]))
    with pytest.raises(InvalidInputError, match="lie in one plane"):
        plan_wires(NWirePhantom((patterns[0], patterns[0])))
    turned = Rotation.from_rotvec([0, 0, 0.1]).as_matrix()
    skew = tuple(Wire(w.name, turned @ w.front_mm, turned @ w.back_mm) for w in patterns[1])
    with pytest.raises(InvalidInputError, match="from parallel"):
        plan_wires(NWirePhantom((patterns[0], (skew[0], skew[1], skew[2]))))
