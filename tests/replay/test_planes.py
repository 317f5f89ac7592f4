"""Anatomy in ultrasound planes: the right voxel at the right pixel, named and turned as radiologists do."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toy_ball import CENTERS, FRACTIONS, RADII
from toy_session import toy_heart

from dvf_ig.core import CycleTiming, FloatArray, Grid, Rigid, SeenPart, TrackedVolume, Volume, VolumeSeries
from dvf_ig.registration import BoundaryTarget, ModelChannels
from dvf_ig.replay.page.planes import anatomy_of_heart, anatomy_of_image, plane_overlay
from dvf_ig.replay.page.registration_inputs import image_overlays, shown_grey, tracked_overlays
from dvf_ig.report.plane_marks import edge_letters, plane_name, viewed_upright

X, Y, Z = np.eye(3)
SLOPE = np.array([2.0, -1.0, 3.0])
POSE = Rigid.from_rotation_vector([0.3, -0.5, 0.8], [6.0, -3.0, 2.0], "mr", "probe")


def oblique(frame: str, shape: tuple[int, int, int], spacing: tuple[float, float, float]) -> Grid:
    direction = Rotation.from_euler("zyx", [10, -15, 20], degrees=True).as_matrix()
    middle = direction @ (np.array(spacing) * (np.array(shape) - 1) / 2)
    return Grid(frame, shape, -middle, np.array(spacing), direction)


def ramp(xyz_mm: FloatArray) -> FloatArray:
    return np.asarray(200.0 + xyz_mm @ SLOPE)


def test_planes_are_named_after_the_nearest_standard_plane() -> None:
    assert plane_name(X) == "sagittal"
    assert plane_name(-2.0 * Y) == "coronal"
    assert plane_name(np.array([0.0, np.sin(0.21), np.cos(0.21)])) == "axial, tilted by 12°"
    assert plane_name(np.array([np.sin(0.6), 0.0, -np.cos(0.6)])) == "oblique, 34° from axial"


def test_edges_carry_the_patients_sides() -> None:
    assert edge_letters(X, Y) == ("R", "L", "A", "P")
    assert edge_letters(Y, -Z) == ("A", "P", "S", "I")
    assert edge_letters(np.array([0.6, -0.8, 0.0]), Z) == ("PR", "AL", "I", "S")


@pytest.mark.parametrize(
    ("axes", "letters"),
    [((X, Y), ("R", "L", "A", "P")), ((X, Z), ("R", "L", "S", "I")), ((Y, Z), ("A", "P", "S", "I"))],
)
def test_any_axes_are_turned_upright(
    axes: tuple[FloatArray, FloatArray], letters: tuple[str, str, str, str]
) -> None:
    for first, second in (axes, axes[::-1]):
        for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            given = np.array([signs[0] * first, signs[1] * second])
            column, row, left, up = viewed_upright(given)
            right, down = given[column] * (-1 if left else 1), given[row] * (-1 if up else 1)
            assert edge_letters(right, down) == letters


def test_where_no_slice_shows_the_surface_none_is_drawn() -> None:
    """Slices show the ball above its centre alone."""
    heart, center = toy_heart(), CENTERS[1]
    bounds_mm = np.tile([center[2], center[2] + 100.0], (heart.model.phases, 1, 1))
    seen = SeenPart(Z, bounds_mm, np.array([0.0, 300.0]), np.zeros(heart.model.phases))
    anatomy = anatomy_of_heart(replace(heart, model=replace(heart.model, seen=seen)), None)
    steps_mm = np.linspace(-15.0, 15.0, 31)
    places_mm = center + steps_mm[:, None, None] * Z + steps_mm[None, :, None] * X
    here = Rigid("mr", "mr", np.eye(3), np.zeros(3))
    got = anatomy.plane(here, places_mm, float(FRACTIONS[1]))
    assert got.distance_mm is not None
    assert np.isnan(got.distance_mm[:15]).all()
    assert np.isfinite(got.distance_mm[16:]).all()


def test_the_balls_contour_is_a_circle_about_its_centre_at_that_phase() -> None:
    """Through both poses: the registered one, and a start that is 5 mm to the side."""
    anatomy = anatomy_of_heart(toy_heart(), None)
    assert anatomy.name == "blood"
    assert "No grey-level MR" in anatomy.remark
    phase, center, radius = FRACTIONS[1], CENTERS[1], RADII[1]
    start = Rigid("mr", "probe", POSE.rotation, POSE.translation_mm + 5.0 * X)
    # 50 by 40 pixels of 1 by 0.8 mm about the ball's centre, in the probe's frame
    middle = POSE.inverse().apply_array(center[None])[0]
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, 0.0]]).T
    frame_from_pixel = np.column_stack([axes, middle - axes @ [24.5, 19.5]])
    image = np.zeros((40, 50), np.uint8)
    got = plane_overlay(anatomy, start, POSE, image, frame_from_pixel, name="a", model_phase=float(phase))
    assert got.size_mm == pytest.approx((50.0, 32.0))
    row, column = np.mgrid[:40, :50]
    pixels = np.stack([column, row, np.ones_like(row)], axis=-1)
    for plane, pose in ((got.start, start), (got.registered, POSE)):
        there = pose.apply_array((pixels @ frame_from_pixel.T).reshape(-1, 3)).reshape(40, 50, 3)
        true_mm = radius - np.linalg.norm(there - center, axis=-1)
        assert plane.distance_mm is not None
        near = np.abs(true_mm) < 4.0
        np.testing.assert_allclose(plane.distance_mm[near], true_mm[near], atol=0.05)
    assert not np.allclose(got.start.distance_mm, got.registered.distance_mm, atol=1.0)


def test_large_images_are_thinned_and_stay_where_they_are() -> None:
    anatomy = anatomy_of_heart(toy_heart(), None)
    image = np.arange(900, dtype=np.uint16)[None].repeat(3, axis=0).astype(np.uint8)
    frame_from_pixel = np.array([[0.05, 0.0, -20.0], [0.0, 0.1, 1.0], [0.0, 0.0, 2.0]])
    here = Rigid.identity("mr", "mr")
    got = plane_overlay(anatomy, here, here, image, frame_from_pixel, name="a", model_phase=0.05)
    assert got.image.shape == (2, 450)
    assert got.pixel_mm == pytest.approx((0.1, 0.2))
    assert got.registered.distance_mm is not None
    x_mm = -20.0 + 0.1 * np.arange(450)
    away = np.sqrt(np.square(x_mm) + 1.0**2 + 2.0**2)  # phase 0: the centre is the origin
    near = np.abs(RADII[0] - away) < 4.0
    np.testing.assert_allclose(got.registered.distance_mm[0, near], (RADII[0] - away)[near], atol=0.05)
    np.testing.assert_array_equal(got.image[0], image[0, ::2])


def test_grey_levels_are_those_of_the_nearest_phase_at_the_place() -> None:
    grid = oblique("mr", (24, 20, 22), (1.5, 2.0, 1.8))
    values = np.stack([ramp(grid.centers_mm()), 1000.0 - ramp(grid.centers_mm())])
    mr = VolumeSeries(grid, values, CycleTiming(np.array([0.1, 0.6]), 0.8))
    anatomy = anatomy_of_heart(toy_heart(), mr)
    assert (anatomy.name, anatomy.remark) == ("MR", "")
    wide = replace(anatomy, window=(0.0, 1000.0))
    xyz_mm = np.random.default_rng(3).uniform(-9, 9, (4, 5, 3))
    here = POSE.inverse().apply_array(xyz_mm.reshape(-1, 3)).reshape(4, 5, 3)
    np.testing.assert_allclose(wide.plane(POSE, here, 0.05).grey, ramp(xyz_mm) / 1000.0, atol=1e-6)
    np.testing.assert_allclose(wide.plane(POSE, here, 0.97).grey, ramp(xyz_mm) / 1000.0, atol=1e-6)
    np.testing.assert_allclose(wide.plane(POSE, here, 0.5).grey, 1.0 - ramp(xyz_mm) / 1000.0, atol=1e-6)
    assert np.isnan(wide.plane(POSE, here + 100.0, 0.5).grey).all()
    low, high = np.percentile(values, [1.0, 99.5])
    assert anatomy.window == pytest.approx((low, high))


def test_the_border_of_blood_is_read_as_the_boundary_fit_does() -> None:
    """Spline coefficients that are linear in the place are the spline's own values."""
    spacing = 2.0
    knots = np.hstack([np.eye(3) / spacing, np.full((3, 1), 9.0)])
    index = np.stack(np.meshgrid(*(np.arange(22),) * 3, indexing="ij"), axis=-1)
    places = (index - 1.0 - 9.0) * spacing  # coefficient j belongs to knot coordinate j − 1
    coefficients = (places @ SLOPE / 10.0).astype(np.float32)[None]
    blood = BoundaryTarget("mr", coefficients, knots, np.zeros(1), -1.0)
    anatomy = anatomy_of_heart(replace(toy_heart(), surface=blood), None)
    xyz_mm = np.random.default_rng(4).uniform(-8, 8, (3, 4, 3))
    plane = anatomy.plane(Rigid.identity("mr", "mr"), xyz_mm, 0.3)
    assert plane.blood_mm is not None
    np.testing.assert_allclose(plane.blood_mm, xyz_mm @ SLOPE / 10.0, atol=1e-5)


def test_surface_only_models_show_their_blood() -> None:
    grid = Grid.axis_aligned("mr", (6, 6, 6), np.full(3, -5.0), 2.0)
    values = np.zeros((1, 6, 6, 6, 2), dtype=np.float32)
    values[..., :3, :, :, 0], values[..., 3:, :, :, 0] = -0.5, 2.0
    heart = replace(toy_heart(), channels=ModelChannels(grid, values, np.zeros(1)))
    anatomy = anatomy_of_heart(heart, None)
    xyz_mm = np.array([[[-4.0, 0.0, 0.0], [4.0, 0.0, 0.0], [9.0, 0.0, 0.0]]])
    two_rows = np.concatenate([xyz_mm, xyz_mm + Y])
    grey = anatomy.plane(Rigid.identity("mr", "mr"), two_rows, 0.0).grey
    np.testing.assert_array_equal(grey[0], [0.0, 1.0, np.nan])


def places_of(overlay_shape: tuple[int, int], frame_from_pixel: FloatArray) -> FloatArray:
    row, column = np.mgrid[: overlay_shape[0], : overlay_shape[1]]
    return np.asarray(np.stack([column, row, np.ones_like(row)], axis=-1) @ frame_from_pixel.T)


def test_planes_of_a_volume_show_ultrasound_and_anatomy_of_the_same_places() -> None:
    """Both images are one ramp in space, so that a pixel of one tells that of the other."""
    us_grid = oblique("fixed", (30, 22, 16), (0.8, 1.0, 1.5))
    pose = Rigid.from_rotation_vector([0.05, 0.1, -0.1], [2.0, 1.0, -1.0], "moving", "fixed")
    grey = ramp(pose.apply_array(us_grid.centers_mm().reshape(-1, 3)).reshape(*us_grid.shape, 3))
    mr_grid = oblique("moving", (40, 40, 40), (1.2, 1.1, 1.0))
    moving = Volume(mr_grid, ramp(mr_grid.centers_mm()))
    anatomy = replace(anatomy_of_image(moving, "moving image"), window=(0.0, 400.0))
    shown = Volume(us_grid, grey)
    overlays = image_overlays(anatomy, shown, Rigid.identity("moving", "fixed"), pose)
    assert len(overlays) == 3
    high = float(np.percentile(grey, 99.5))
    for overlay in overlays:
        level = (overlay.image.astype(float) - 1.0) / 254.0 * high
        unclipped = overlay.image < 245
        np.testing.assert_allclose(
            level[unclipped], 400.0 * overlay.registered.grey[unclipped], atol=1.5 * high / 254
        )
        assert not np.allclose(overlay.start.grey, overlay.registered.grey, atol=0.003)
        assert overlay.pixel_mm[0] == pytest.approx(overlay.pixel_mm[1])
        assert overlay.event_s is None
        assert overlay.model_phase is None
        assert overlay.registered.distance_mm is None
    assert {overlay.name for overlay in overlays} == {
        f"fixed image, across its {axis} axis" for axis in ("first", "second", "third")
    }
    assert overlays[0].size_mm == pytest.approx((22.0, 24.0), rel=0.1)  # 22 by 16 voxels of 1 and 1.5 mm
    letters = [overlay.registered.edges for overlay in overlays]
    assert [edges[1] for edges in letters] == ["P", "L", "L"]
    assert [edges[3] for edges in letters] == ["I", "I", "P"]


def test_two_of_many_gated_volumes_are_shown_with_their_phase() -> None:
    grid = oblique("probe", (12, 10, 8), (1.0, 1.0, 1.0))
    seen = np.ones(grid.shape, dtype=np.uint8)
    seen[:2] = 0
    tracker = Rigid.from_rotation_vector([0.0, 0.0, 0.2], [1.0, 0.0, 0.0], "tracker", "probe")
    volumes = [
        TrackedVolume(
            Volume(grid, np.full(grid.shape, 90, np.uint8)), Volume(grid, seen), tracker, k / 10, float(k)
        )
        for k in range(5)
    ]
    pose = Rigid.from_rotation_vector([0.1, 0.0, 0.0], [0.0, 1.0, 0.0], "mr", "tracker")
    overlays = tracked_overlays(anatomy_of_heart(toy_heart(), None), volumes, pose, pose)
    assert [overlay.model_phase for overlay in overlays] == [0.0] * 3 + [0.4] * 3
    assert [overlay.event_s for overlay in overlays] == [None] * 3 + [4.0] * 3
    assert overlays[0].name == "volume 1, across its first axis"
    assert overlays[5].name == "volume 5, across its third axis"
    assert set(np.unique(overlays[0].image)) == {90}
    assert 0 in overlays[1].image
    assert len(tracked_overlays(anatomy_of_heart(toy_heart(), None), volumes[:1], pose, pose)) == 3


def test_nothing_outside_the_fan_is_shown_grey() -> None:
    grey = shown_grey(np.array([0.0, np.nan, 10.0, 5.0, -10.0]))
    assert grey.tolist()[:2] == [0, 0]
    assert grey[2] > grey[3] > grey[4] == 1
    assert shown_grey(np.zeros(3)).tolist() == [0, 0, 0]


def test_outlines_lie_between_classes_of_tissue() -> None:
    grid = Grid.axis_aligned("moving", (9, 9, 9), np.zeros(3), 1.0)
    values = np.full(grid.shape, 100.0)
    values[:3], values[6:] = 20.0, 180.0
    levels = anatomy_of_image(Volume(grid, values), "moving image").outline_levels
    assert 0.0 <= levels[0] < 0.5 < levels[1] <= 1.0
    two = np.where(values > 50.0, 1.0, 0.0)
    assert anatomy_of_image(Volume(grid, two), "moving image").outline_levels == ()
