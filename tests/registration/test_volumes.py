"""Gated volumes as planes, averaged as a NumPy reference says, placed where they were seen; known poses."""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toy_heart import CENTER_MM, toy_mr, toy_pose
from toy_volume import resampled, toy_surface, toy_volume

from dvf_ig.core import (
    AnyArray,
    BoolArray,
    FloatArray,
    FrameMismatchError,
    Grid,
    InvalidInputError,
    Points,
    Rigid,
    TrackedVolume,
    Volume,
)
from dvf_ig.kernels.grid.pool import pool_blocks, pool_cubes
from dvf_ig.registration import (
    VOLUME_SMOOTHING_MM,
    BoundaryTarget,
    HeartChannels,
    PoseChart,
    RegistrationResult,
    SliceSet,
    channels_from_mr,
    images_of_volumes,
    register,
    target_errors_mm,
)
from dvf_ig.registration.lc2.slices import joined, prepare_volumes, within

TURN = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
POSE = Rigid.from_rotation_vector([-0.6, 0.2, 1.1], [40.0, -70.0, 15.0], "tracker", "probe")
SHAPE = (20, 16, 13)


def oblique(spacing_mm: float = 1.5, shape: tuple[int, int, int] = SHAPE) -> Grid:
    return Grid("probe", shape, np.array([-7.0, 3.0, 11.0]), np.full(3, spacing_mm), TURN)


def tracked(
    grey: AnyArray, *, mask: AnyArray | None = None, grid: Grid | None = None, pose: Rigid = POSE
) -> TrackedVolume:
    grid = grid or oblique(shape=(grey.shape[0], grey.shape[1], grey.shape[2]))
    seen = np.ones(grey.shape, dtype=np.uint8) if mask is None else mask
    return TrackedVolume(Volume(grid, grey), Volume(grid, seen), pose, 0.35, 2.5)


def places(slices: SliceSet) -> FloatArray:
    """(s, rows, columns, 3) mm of every pixel, in the slices' frame."""
    row, column = np.mgrid[: slices.images.shape[1], : slices.images.shape[2]]
    pixels = np.stack([column, row, np.ones_like(row)], axis=-1)
    return np.asarray(np.einsum("sij,rcj->srci", slices.frame_from_pixel, pixels))


def on_planes(shape: tuple[int, ...], every: int) -> BoolArray:
    """What of a volume lies on planes that are looked at."""
    return np.asarray((np.indices(shape) % every == every // 2).any(axis=0))


@pytest.mark.parametrize(("step", "every"), [(1, 4), (2, 1), (3, 2)])
def test_blocks_are_averaged_as_the_twin_says(step: int, every: int) -> None:
    rng = np.random.default_rng(step)
    grey = rng.integers(0, 256, SHAPE).astype(np.uint8)
    mask = (rng.random(SHAPE) > 0.01).astype(np.uint8) * 7
    small = tuple(n // step for n in SHAPE)
    cut = tuple(slice(0, n * step) for n in small)
    blocks = (small[0], step, small[1], step, small[2], step)
    mean = grey[cut].astype(np.float64).reshape(blocks).mean(axis=(1, 3, 5))
    whole = (mask[cut] > 0).reshape(blocks).all(axis=(1, 3, 5)) & on_planes(small, every)
    out = np.full(small, -1.0, dtype=np.float32)
    pool_blocks(grey, mask, step, every, out)
    assert 0 < whole.sum() < whole.size
    np.testing.assert_allclose(out, np.where(whole, mean, np.nan), rtol=2e-6)


@pytest.mark.parametrize(
    ("edge", "every"), [((2.5, 1.25, 3.3), 1), ((2.0, 2.0, 2.0), 2), ((0.6, 1.7, 0.9), 5)]
)
def test_cubes_are_averaged_as_the_twin_says(edge: tuple[float, float, float], every: int) -> None:
    """The twin weights every voxel along each axis by the length of its overlap with the cube."""
    rng = np.random.default_rng(3)
    grey = rng.integers(0, 256, SHAPE).astype(np.uint8)
    mask = (rng.random(SHAPE) > 0.01).astype(np.uint8) * 5
    counts = [int(n / e + 1e-9) for n, e in zip(SHAPE, edge, strict=True)]
    weights = []
    for n, m, e in zip(SHAPE, counts, edge, strict=True):
        low, voxel = e * np.arange(m)[:, None], np.arange(n)
        weights.append(np.clip(np.minimum(low + e, voxel + 1) - np.maximum(low, voxel), 0, None) / e)
    mean = np.einsum("ia,jb,kc,abc->ijk", *weights, grey, optimize=True)
    seen = np.einsum("ia,jb,kc,abc->ijk", *weights, mask > 0, optimize=True) > 1 - 1e-6
    seen &= on_planes(tuple(counts), every)
    out = np.full(counts, -1.0, dtype=np.float32)
    pool_cubes(grey, mask, np.array(edge), every, out)
    assert 0 < seen.sum() < seen.size
    np.testing.assert_allclose(out, np.where(seen, mean, np.nan), rtol=2e-6)


def test_cubes_of_whole_voxels_are_blocks() -> None:
    rng = np.random.default_rng(5)
    grey, mask = rng.integers(0, 256, SHAPE).astype(np.uint8), np.ones(SHAPE, dtype=np.uint8)
    small = tuple(n // 3 for n in SHAPE)
    blocks, cubes = np.zeros(small, dtype=np.float32), np.zeros(small, dtype=np.float32)
    pool_blocks(grey, mask, 3, 1, blocks)
    pool_cubes(grey, mask, np.full(3, 0.3 / 0.1), 1, cubes)
    np.testing.assert_allclose(cubes, blocks, rtol=2e-6)


def test_a_bright_block_is_where_the_tracker_saw_it_on_planes_along_every_axis() -> None:
    grey = np.zeros(SHAPE, dtype=np.uint8)
    grey[8:10, 4:6, 6:8] = 200
    slices = prepare_volumes([tracked(grey)], pitch_mm=3.0, planes=20)
    bright = slices.images > 0
    assert bright.sum() == 3, "one pixel of one plane along each axis"
    middle = POSE.apply_array(oblique().to_mm(np.array([8.5, 4.5, 6.5])))
    np.testing.assert_allclose(places(slices)[bright], np.tile(middle, (3, 1)), atol=1e-9)
    np.testing.assert_allclose(slices.images[bright], 200, rtol=1e-6)
    normals = [np.cross(m[:, 0], m[:, 1]) for m in slices.frame_from_pixel[bright.any(axis=(1, 2))]]
    along = np.abs(np.array(normals) @ POSE.rotation @ TURN) / np.linalg.norm(normals, axis=1)[:, None]
    np.testing.assert_allclose(along[np.argmax(along, axis=1).argsort()], np.eye(3), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(slices.frame_from_pixel[:, :, :2], axis=1), 3.0, rtol=1e-9)
    assert slices.frame == "tracker"
    assert set(slices.model_phase) == {0.35}
    assert set(slices.t_s) == {2.5}


def test_brightness_follows_place_on_every_pixel() -> None:
    """Grey grows along one direction of space: the reference reads it at the place that each pixel claims."""
    grid = oblique()
    direction = np.array([0.6, -0.3, 0.74])
    ramp = grid.centers_mm() @ direction
    level = (ramp - ramp.min()) / np.ptp(ramp)
    grey = np.rint(255 * (0.2 + 0.8 * level)).astype(np.uint8)
    slices = prepare_volumes([tracked(grey)], pitch_mm=3.0, planes=4)
    in_probe = POSE.inverse().apply_array(places(slices)[slices.masks])
    expected = 255 * (0.2 + 0.8 * (in_probe @ direction - ramp.min()) / np.ptp(ramp))
    # half a level of rounding
    np.testing.assert_allclose(slices.images[slices.masks], expected, atol=0.5)


def test_what_was_not_insonified_is_no_pixel() -> None:
    rng = np.random.default_rng(1)
    grey = rng.integers(100, 256, SHAPE).astype(np.uint8)
    first = 7
    mask = np.zeros(SHAPE, dtype=np.uint8)
    mask[first:] = 1
    slices = prepare_volumes([tracked(grey, mask=mask)], pitch_mm=3.0, planes=20)
    index = oblique().to_index(POSE.inverse().apply_array(places(slices)))
    # the block of voxels 6 and 7 lies half outside and is left out whole
    inside = (index[..., 0] > first + 0.9) & (index > 0).all(axis=-1) & (index < np.array(SHAPE) - 1).all(-1)
    np.testing.assert_array_equal(slices.masks, inside)
    assert (slices.images[slices.masks] > 99).all()
    assert not slices.images[~slices.masks].any()


def test_volumes_keep_their_own_pose_and_phase() -> None:
    grey = np.zeros(SHAPE, dtype=np.uint8)
    grey[8:10, 4:6, 6:8] = 255
    larger = np.zeros((24, 16, 13), dtype=np.uint8)
    larger[8:10, 4:6, 6:8] = 255
    other = Rigid.from_rotation_vector([0.1, 0.9, -0.4], [-30.0, 5.0, 80.0], "tracker", "probe")
    grid = oblique(shape=(24, 16, 13))
    second = TrackedVolume(Volume(grid, larger), Volume(grid, np.ones_like(larger)), other, 0.7)
    slices = prepare_volumes([tracked(grey), second], pitch_mm=3.0, planes=20)
    middle = oblique().to_mm(np.array([8.5, 4.5, 6.5]))
    for phase, pose in ((0.35, POSE), (0.7, other)):
        chosen = slices.subset(np.flatnonzero(slices.model_phase == phase))
        found = places(chosen)[chosen.images > 250]
        np.testing.assert_allclose(found, np.tile(pose.apply_array(middle), (3, 1)), atol=1e-9)


def seen_ramp(spacing_mm: tuple[float, float, float], pose: Rigid) -> TrackedVolume:
    """Grey that grows along one direction of the tracker's space, on voxels of any edges."""
    shape = tuple(round(30.0 / h) for h in spacing_mm)
    grid = Grid("probe", shape, np.array([-7.0, 3.0, 11.0]), np.array(spacing_mm), TURN)
    level = 0.5 + 0.01 * (pose.apply_array(grid.centers_mm()) @ RAMP - RAMP_MM)
    grey = np.rint(255 * level)
    return tracked(grey.astype(np.uint8), grid=grid, pose=pose)


RAMP = np.array([0.6, -0.3, 0.74])
RAMP_MM = float(POSE.apply_array(oblique().to_mm(np.array([10.0, 10.0, 10.0]))) @ RAMP)


@pytest.mark.parametrize("spacing", [(0.6, 0.6, 1.2), (2.5, 0.7, 1.1), (1.5, 1.5, 1.5)])
def test_unequal_voxels_are_seen_where_they_are(spacing: tuple[float, float, float]) -> None:
    """Each pixel shows the ramp at the place it claims, at one pitch, whatever the voxels' edges."""
    other = POSE.perturbed_left(np.array([0.2, -0.3, 0.1]), np.array([4.0, -2.0, 3.0]), np.zeros(3))
    volumes = [seen_ramp(spacing, POSE), seen_ramp((0.9, 0.9, 0.9), other)]
    slices = prepare_volumes(volumes, pitch_mm=2.0, planes=5)
    expected = 255 * (0.5 + 0.01 * (places(slices)[slices.masks] @ RAMP - RAMP_MM))
    # half a level of rounding, and voxels of one grey level each that are cut by the cubes
    np.testing.assert_allclose(slices.images[slices.masks], expected, atol=1.0)
    np.testing.assert_allclose(np.linalg.norm(slices.frame_from_pixel[:, :, :2], axis=1), 2.0, rtol=1e-9)


@pytest.mark.parametrize("planes", [2, 4, 6])
def test_about_so_many_planes_are_taken_along_each_axis(planes: int) -> None:
    grey = np.full((24, 24, 24), 128, dtype=np.uint8)
    slices = prepare_volumes([tracked(grey)], pitch_mm=1.5, planes=planes)
    assert len(slices) == 3 * planes
    center = POSE.apply_array(oblique().to_mm(np.full(3, 11.5)))
    # to within half a plane's distance they lie about the middle
    assert np.abs(places(slices).mean(axis=(0, 1, 2)) - center).max() < 0.5 * 1.5 * 24 / planes


def test_misuse_is_refused() -> None:
    grey = np.full(SHAPE, 90, dtype=np.uint8)
    with pytest.raises(InvalidInputError, match="at least one"):
        prepare_volumes([], pitch_mm=3.0, planes=6)
    with pytest.raises(InvalidInputError, match="insonified"):
        prepare_volumes([tracked(grey, mask=np.zeros(SHAPE, dtype=np.uint8))], pitch_mm=3.0, planes=6)
    elsewhere = Rigid.from_rotation_vector([0, 0, 0], [0, 0, 0], "room", "probe")
    with pytest.raises(FrameMismatchError):
        prepare_volumes([tracked(grey), tracked(grey, pose=elsewhere)], pitch_mm=3.0, planes=6)
    with pytest.raises(FrameMismatchError):
        tracked(grey, pose=Rigid.from_rotation_vector([0, 0, 0], [0, 0, 0], "tracker", "plane"))
    with pytest.raises(InvalidInputError, match="uint8"):
        tracked(grey.astype(np.float32))
    small = Volume(oblique(shape=(3, 3, 3)), np.ones((3, 3, 3), dtype=np.uint8))
    with pytest.raises(InvalidInputError, match="same grid"):
        TrackedVolume(Volume(oblique(), grey), small, POSE, 0.0)


def test_a_volume_smaller_than_a_block_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        prepare_volumes([tracked(np.full((4, 4, 2), 90, dtype=np.uint8))], pitch_mm=4.5, planes=6)


def flat_slices(count: int, rows: int, columns: int, frame: str = "tracker", seed: int = 0) -> SliceSet:
    rng = np.random.default_rng(seed)
    masks = rng.random((count, rows, columns)) > 0.2
    maps = np.stack(
        [
            np.column_stack([2.0 * r[:, :2], rng.normal(0, 8, 3)])
            for r in Rotation.random(count, rng=rng).as_matrix()
        ]
    )
    images = np.where(masks, rng.random(masks.shape), 0).astype(np.float32)
    return SliceSet(frame, images, masks, maps, rng.random(count), np.arange(count) + 10.0 * seed)


def test_within_keeps_what_the_image_covers() -> None:
    slices = flat_slices(5, 14, 11)
    grid = Grid("mr", (12, 15, 9), np.array([-9.0, -12.0, -6.0]), np.array([2.0, 1.5, 2.5]), TURN.T)
    pose = Rigid.from_rotation_vector([0.2, 0.1, -0.4], [3.0, -2.0, 1.0], "mr", "tracker")
    found = within(slices, grid, pose)
    index = grid.to_index(pose.apply_array(places(slices)))
    covered = ((index >= 0) & (index <= np.array(grid.shape) - 1)).all(axis=-1)
    np.testing.assert_array_equal(found.masks, slices.masks & covered)
    assert 0 < found.masks.sum() < slices.masks.sum()
    np.testing.assert_array_equal(found.images, np.where(covered, slices.images, 0))
    for name in ("frame_from_pixel", "model_phase", "t_s"):
        np.testing.assert_array_equal(getattr(found, name), getattr(slices, name))


def test_joined_slices_are_the_same_slices() -> None:
    first, second = flat_slices(2, 5, 9), flat_slices(3, 8, 6, seed=1)
    both = joined([first, second])
    assert both.images.shape == both.masks.shape == (5, 8, 9)
    for part, kept in ((first, slice(0, 2)), (second, slice(2, 5))):
        _, rows, columns = part.images.shape
        np.testing.assert_array_equal(both.images[kept, :rows, :columns], part.images)
        np.testing.assert_array_equal(both.masks[kept, :rows, :columns], part.masks)
        for name in ("frame_from_pixel", "model_phase", "t_s"):
            np.testing.assert_array_equal(getattr(both, name)[kept], getattr(part, name))
        assert both.masks[kept].sum() == part.masks.sum()
        assert np.count_nonzero(both.images[kept]) == np.count_nonzero(part.images)
    with pytest.raises(FrameMismatchError):
        joined([first, flat_slices(2, 5, 9, frame="room")])


def registered(
    seed: int,
    surface: BoundaryTarget | None,
    *,
    away_mm: float = 15.0,
    changed: Callable[[TrackedVolume], TrackedVolume] = lambda volume: volume,
) -> RegistrationResult:
    """Two views of the toy heart from a start `away_mm` off."""
    xi = np.random.default_rng(seed).normal(size=6)
    views = [toy_volume((0.5, 0.2, -0.4), seed), toy_volume((-0.6, 0.9, 0.3), seed + 100)]
    channels = channels_from_mr(toy_mr(), smoothing_mm=VOLUME_SMOOTHING_MM)
    return register(
        images_of_volumes([changed(view) for view in views], grey=False, clock=perf_counter),
        HeartChannels(channels, CENTER_MM, surface),
        PoseChart(toy_pose(), CENTER_MM).pose(away_mm * xi / np.linalg.norm(xi)),
        rng=np.random.default_rng(0),
        clock=perf_counter,
    )


@pytest.fixture(scope="module")
def plain() -> RegistrationResult:
    return registered(1, toy_surface())


def test_volumes_and_a_surface_recover_a_displacement() -> None:
    """From 25 mm a search that begins at the given start alone does not arrive."""
    result = registered(2, toy_surface(), away_mm=25.0)
    targets = Points("mr", CENTER_MM + np.random.default_rng(1).uniform(-40, 40, (27, 3)))
    # labels of 2 mm voxels place their surface to 0.12 voxels, 0.24 mm; speckle of 0.3 on 1.5 mm voxels,
    # averaged over the boundary's 3 mm Gaussian and over LC2's patches, adds a third of that; the fit looks
    # for a change of shape that this heart does not have, which spreads the pose by as much again
    assert target_errors_mm(result.target_from_source, toy_pose(), targets).mean() < 0.45
    assert result.stop.usable
    assert result.evidence.boundary_mm is not None
    assert result.evidence.boundary_mm < 0.4


def test_oblique_unequal_voxels_give_the_pose_of_cubes(plain: RegistrationResult) -> None:
    """The same two views on 0.6 × 0.6 × 1.2 mm voxels whose axes are turned."""
    turn = Rotation.from_rotvec([-0.4, 0.3, 0.5]).as_matrix()
    spacing = np.array([0.6, 0.6, 1.2])
    targets = Points("mr", CENTER_MM + np.random.default_rng(1).uniform(-40, 40, (27, 3)))
    boxes = registered(1, toy_surface(), changed=lambda volume: resampled(volume, spacing, turn))
    cubes_mm, boxes_mm = (
        target_errors_mm(found.target_from_source, toy_pose(), targets).mean() for found in (plain, boxes)
    )
    assert abs(boxes_mm - cubes_mm) < 0.2
    assert boxes_mm < 0.32
    assert boxes.stop.usable


def test_the_pose_goes_with_the_boundary(plain: RegistrationResult) -> None:
    """The surface 1.5 mm to the side takes the result along: its labels place it better than speckle does."""
    surface, shift = toy_surface(), np.array([0.9, -1.2, 0.0])
    knots = surface.knots_from_mm.copy()
    knots[:, 3] -= knots[:, :3] @ shift
    pulled = registered(1, replace(surface, knots_from_mm=knots))
    place = toy_pose().inverse().apply_array(CENTER_MM)
    moved = pulled.target_from_source.apply_array(place) - plain.target_from_source.apply_array(place)
    along = float(moved @ shift / (shift @ shift))
    assert 0.2 < along < 1.1
    assert np.linalg.norm(moved - along * shift) < 0.2
    assert pulled.evidence.boundary_mm == pytest.approx(1.5, abs=0.3)


def test_a_boundary_elsewhere_makes_the_pose_less_certain() -> None:
    surface, shift = toy_surface(), np.array([0.0, 0.0, 3.0])
    knots = surface.knots_from_mm.copy()
    knots[:, 3] -= knots[:, :3] @ shift
    elsewhere = replace(surface, knots_from_mm=knots)
    agreed, disagreed = (registered(1, target, away_mm=3.0).covariance for target in (surface, elsewhere))
    assert disagreed[5, 5] > 1.5 * agreed[5, 5]
