"""Boundary points in slices, their distance to the model: closed forms, a NumPy reference, known poses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from toy_heart import CENTER_MM, toy_mr, toy_pose, toy_slices

from dvf_ig.core import (
    HEART_RADIUS_MM,
    CycleTiming,
    FloatArray,
    FrameMismatchError,
    Grid,
    InvalidInputError,
    Rigid,
    VolumeSeries,
    mean_displacement_mm,
)
from dvf_ig.kernels.boundary import SUMS, UNKNOWNS, DistanceSplines, OrientedPoints, boundary_step_sums
from dvf_ig.kernels.spline import spline_batch
from dvf_ig.registration import (
    Boundary,
    BoundaryTarget,
    PoseChart,
    SliceSet,
    boundary_points,
    target_from_labels,
)
from dvf_ig.registration.boundary.fit import boundary_starts, fit_boundary
from dvf_ig.registration.boundary.points import BoundaryPoints, edges_of_model_mm
from dvf_ig.registration.boundary.target import signed_distance_mm

TARGETS = CENTER_MM + np.random.default_rng(1).uniform(-40, 40, (27, 3))


def tre_mm(pose: Rigid) -> float:
    moving = toy_pose().inverse().apply_array(TARGETS)
    return float(np.linalg.norm(pose.apply_array(moving) - TARGETS, axis=1).mean())


def displaced(mm: float, seed: int) -> Rigid:
    xi = np.random.default_rng(seed).normal(size=6)
    return PoseChart(toy_pose(), CENTER_MM).pose(xi * mm / np.linalg.norm(xi))


def disc_slices(radius_mm: float, pitch_mm: float) -> SliceSet:
    """Two planes through the middle of a dark ball in bright muscle, seen in a round sector."""
    size = int(90 / pitch_mm)
    row, col = np.mgrid[:size, :size]
    middle = (size - 1) / 2
    away_mm = pitch_mm * np.hypot(row - middle - 0.3, col - middle + 0.2)
    image = (0.6 + 0.4 * np.tanh((away_mm - radius_mm) / 1.5)).astype(np.float32)
    mask = np.hypot(row - middle, col - middle) < 0.48 * size
    first = np.column_stack([[pitch_mm, 0, 0], [0, pitch_mm, 0], [5.0, -7.0, 11.0]])
    second = np.column_stack([[0, pitch_mm, 0], [0, 0, pitch_mm], [1.0, 2.0, 3.0]])
    return SliceSet(
        "tracker",
        np.stack([np.where(mask, image, 0)] * 2),
        np.stack([mask] * 2),
        np.stack([first, second]),
        np.array([0.1, 0.6]),
        np.zeros(2),
    )


def test_boundary_points_of_a_ball_lie_on_its_circle_with_normals_outward() -> None:
    slices = disc_slices(22.0, 1.5)
    points = boundary_points(slices)
    middle = (slices.images.shape[1] - 1) / 2
    for place, phase in zip(slices.frame_from_pixel, slices.model_phase, strict=True):
        mine = points.model_phase == phase
        outward = points.points_mm[mine] - place @ np.array([middle - 0.2, middle + 0.3, 1.0])
        radius = np.linalg.norm(outward, axis=1)
        assert mine.sum() > 60
        # blurred by 3 mm and its own 1.36 mm, a circle is steepest σ²/2r = 0.25 mm inside of where it was
        error = radius - (22.0 - (3.0**2 + 1.36**2) / 44.0)
        assert np.abs(error).max() < 1.5 / 8  # pixels of 1.5 mm
        assert abs(error.mean()) < 0.05
        cosine = np.einsum("ni,ni->n", points.normals[mine], outward) / radius
        assert cosine.min() > 0.995


@pytest.mark.parametrize("radius_mm", [12.0, 22.0])
def test_edges_of_the_model_lie_where_points_of_its_images_do(radius_mm: float) -> None:
    """A ball seen in planes through its middle: as above, on the other side of a plane there is none."""
    index = np.stack(np.meshgrid(*[np.arange(50.0)] * 3, indexing="ij"), axis=-1)
    distance = radius_mm - np.linalg.norm(2.0 * index - 50.0, axis=-1)
    knots = np.column_stack([0.5 * np.eye(3), -np.ones(3)])
    splines = DistanceSplines(distance[None].astype(np.float32), knots, -1.0)
    normals = np.random.default_rng(2).normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    planes = np.cross(normals, np.array([0.3, 0.5, 0.8]))
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    phases = np.zeros(40, dtype=np.int64)
    found = edges_of_model_mm(splines, 50.0 + radius_mm * normals, normals, planes, phases)
    assert found == pytest.approx(np.full(40, -(3.0**2) / (2.0 * radius_mm)), abs=0.12)
    inwards = edges_of_model_mm(splines, 50.0 + radius_mm * normals, -normals, planes, phases)
    assert np.isnan(inwards).all()


def test_the_rim_of_the_sector_is_no_boundary() -> None:
    slices = disc_slices(22.0, 1.5)
    flat = replace(slices, images=np.where(slices.masks, np.float32(0.5), np.float32(0)))
    assert len(boundary_points(flat)) == 0


def test_slices_of_unequal_pitch_are_refused() -> None:
    slices = disc_slices(22.0, 1.5)
    places = slices.frame_from_pixel.copy()
    places[1, :, :2] *= 2
    with pytest.raises(InvalidInputError, match="at one pitch"):
        boundary_points(replace(slices, frame_from_pixel=places))


def test_subsampling_keeps_every_slice() -> None:
    points = boundary_points(disc_slices(22.0, 1.5))
    few = points.subsampled(40)
    assert len(few) == 40
    assert set(few.model_phase) == {0.1, 0.6}


@pytest.mark.parametrize("spacing", [(1.8, 1.8, 1.8), (1.2, 1.5, 2.5)])
def test_distance_to_a_voxelled_ball(spacing: tuple[float, float, float]) -> None:
    h = np.array(spacing)
    shape = tuple(int(n) for n in np.ceil(90 / h))
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    true = 25.0 - np.linalg.norm(index * h - 45.3, axis=-1)
    found = signed_distance_mm(true > 0, h)
    band = np.abs(true) < 15
    # in voxels along their longest edge, where they sample most coarsely: a binary mask says where the
    # surface is to within half a voxel either way, 0.29 RMS if nothing were done about it; smoothing the mask
    # by 0.8 h moves a ball's surface inward by (0.8 h)²/r, 0.04 h
    error = (found - true)[band] / h.max()
    assert np.sqrt(np.mean(error**2)) < 0.12
    assert abs(np.mean(error)) < 0.07


def test_a_phase_without_blood_is_refused() -> None:
    grid = Grid.axis_aligned("mr", (8, 8, 8), np.zeros(3), 1.0)
    empty = VolumeSeries(grid, np.ones((2, 8, 8, 8), np.uint8), CycleTiming.uniform(2, 0.8))
    with pytest.raises(InvalidInputError, match="no blood or nothing else"):
        target_from_labels(empty, np.zeros(1))


def toy_labels() -> VolumeSeries:
    mr = toy_mr()
    values = np.where(mr.values > 200, 2, np.where(mr.values < 130, 1, 0)).astype(np.uint8)
    return VolumeSeries(mr.grid, values, mr.timing)


@pytest.fixture(scope="module")
def target() -> BoundaryTarget:
    return target_from_labels(toy_labels(), np.zeros(3))


@pytest.fixture(scope="module")
def points() -> BoundaryPoints:
    slices = toy_slices(toy_mr(), toy_pose(), np.random.default_rng(50), pitch_mm=1.5, speckle=0.3)
    return boundary_points(slices)


def test_only_phases_in_use_are_built(target: BoundaryTarget) -> None:
    assert target.coefficients.shape == (1, *toy_labels().grid.shape)
    np.testing.assert_array_equal(target.nearest_phase(np.array([0.0, 0.5, 0.9])), 0)


def _sums_reference(
    points: BoundaryPoints, target: BoundaryTarget, pose: Rigid, offset_mm: float, sigma_mm: float
) -> FloatArray:
    """What `boundary_step_sums` says, in array arithmetic, with the fixture's own spline kernel."""
    h = 1.0 / target.knots_from_mm[0, 0]
    at = pose.apply_array(points.points_mm)
    d, g, status = np.empty(len(at)), np.empty((len(at), 3)), np.empty(len(at), dtype=np.int64)
    spline_batch(target.coefficients, -h * target.knots_from_mm[:, 3], h, 0, at, d, g, status)
    unit = g / np.linalg.norm(g, axis=1, keepdims=True)
    agree = np.clip(target.polarity * np.einsum("ni,ni->n", points.normals @ pose.rotation.T, unit), 0, None)
    a = np.where(status == 0, points.weights * agree, 0.0)
    r = d - offset_mm
    near = 1 / (1 + (r / sigma_mm) ** 2)
    turn = np.cross(at - CENTER_MM, g) / HEART_RADIUS_MM
    jacobian = np.hstack([turn, g, -np.ones((len(at), 1))])
    use = a > 0
    jacobian, a, r, near = jacobian[use], a[use], r[use], near[use]
    weight = (a * near**2)[:, None]
    tail = [np.sum(a * near), np.sum(a), np.sum(weight[:, 0] * r * r)]
    square = jacobian.T @ (weight * jacobian)
    return np.concatenate([square.ravel(), (weight * jacobian).T @ r, tail])


def test_the_kernel_s_sums_are_those_of_its_twin(points: BoundaryPoints, target: BoundaryTarget) -> None:
    pose, center = displaced(7.0, 4), CENTER_MM.copy()
    out = np.empty(SUMS)
    boundary_step_sums(
        OrientedPoints(
            points.points_mm, points.normals, points.weights, target.nearest_phase(points.model_phase)
        ),
        DistanceSplines(target.coefficients, target.knots_from_mm, target.polarity),
        pose.matrix[:3],
        center,
        HEART_RADIUS_MM,
        0.4,
        3.0,
        out,
    )
    expected = _sums_reference(points, target, pose, 0.4, 3.0)
    np.testing.assert_allclose(out, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert len(expected) == UNKNOWNS * (UNKNOWNS + 1) + 3


@pytest.mark.parametrize("seed", [1, 2])
def test_recovers_a_15_mm_displacement(points: BoundaryPoints, target: BoundaryTarget, seed: int) -> None:
    fit = fit_boundary(Boundary(points, target), displaced(15.0, seed), CENTER_MM)
    assert fit.converged
    # speckle of 0.3 on 1.5 mm pixels moves a point by about 0.3 mm, hundreds of points by a tenth of that;
    # 2 mm voxels add 0.1 mm
    assert tre_mm(fit.pose) < 0.35
    assert fit.share_near > 0.5
    assert np.linalg.eigvalsh(fit.covariance).min() > 0


def test_the_end_does_not_depend_on_the_start(points: BoundaryPoints, target: BoundaryTarget) -> None:
    first, second = (
        fit_boundary(Boundary(points, target), displaced(8.0, seed), CENTER_MM).pose for seed in (5, 6)
    )
    assert mean_displacement_mm(first, second, CENTER_MM) < 0.05


def test_a_uniform_offset_is_found_and_costs_no_accuracy(
    points: BoundaryPoints, target: BoundaryTarget
) -> None:
    plain = fit_boundary(Boundary(points, target), displaced(5.0, 7), CENTER_MM)
    shifted = replace(target, coefficients=target.coefficients + np.float32(0.8))
    fit = fit_boundary(Boundary(points, shifted), displaced(5.0, 7), CENTER_MM)
    # held towards zero with a standard deviation of 1 mm: a tenth of it may be missing
    assert fit.offset_mm - plain.offset_mm == pytest.approx(0.8, abs=0.1)
    assert mean_displacement_mm(fit.pose, plain.pose, CENTER_MM) < 0.1


def test_normals_that_disagree_do_not_count(points: BoundaryPoints, target: BoundaryTarget) -> None:
    at_truth = fit_boundary(Boundary(points, target), toy_pose(), CENTER_MM)
    turned = replace(points, normals=-points.normals)
    assert (
        fit_boundary(Boundary(turned, target), toy_pose(), CENTER_MM).share_near < 0.5 * at_truth.share_near
    )


def test_a_start_without_any_match_is_not_converged(points: BoundaryPoints, target: BoundaryTarget) -> None:
    far = PoseChart(toy_pose(), CENTER_MM).pose(np.array([0.0, 0, 0, 900, 0, 0]))
    fit = fit_boundary(Boundary(points, target), far, CENTER_MM)
    assert not fit.converged
    assert fit.share_near == 0.0
    assert np.isnan(fit.covariance).all()


def test_frames_must_meet(points: BoundaryPoints, target: BoundaryTarget) -> None:
    with pytest.raises(FrameMismatchError):
        fit_boundary(Boundary(points, target), toy_pose().inverse(), CENTER_MM)


def test_many_starts_reach_30_mm_and_their_ends_are_distinct(
    points: BoundaryPoints, target: BoundaryTarget
) -> None:
    ends = boundary_starts(
        Boundary(points, target), displaced(30.0, 11), CENTER_MM, rng=np.random.default_rng(2), spread_mm=20.0
    )
    assert tre_mm(ends[0].pose) < 0.35
    assert [e.score for e in ends] == sorted((e.score for e in ends), reverse=True)
    for i, one in enumerate(ends):
        for other in ends[:i]:
            assert mean_displacement_mm(one.pose, other.pose, CENTER_MM) > 4.0
    again = boundary_starts(
        Boundary(points, target), displaced(30.0, 11), CENTER_MM, rng=np.random.default_rng(2), spread_mm=20.0
    )
    np.testing.assert_array_equal(ends[0].pose.matrix, again[0].pose.matrix)


def test_labels_on_a_turned_grid_give_the_same_distance() -> None:
    """Axes swapped and one reversed, as other scanners store them: the place of the surface stays."""
    labels = toy_labels()
    grid = labels.grid
    direction = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])
    turned = Grid(
        "mr",
        (grid.shape[1], grid.shape[2], grid.shape[0]),
        grid.to_mm(np.array([grid.shape[0] - 1, 0, grid.shape[2] - 1], dtype=np.float64)),
        grid.spacing_mm,
        direction,
    )
    values = np.ascontiguousarray(np.transpose(labels.values, (0, 2, 3, 1))[:, :, ::-1, ::-1])
    other = VolumeSeries(turned, values, labels.timing)
    found = []
    for series in (labels, other):
        made = target_from_labels(series, np.zeros(1))
        q = CENTER_MM + np.random.default_rng(3).uniform(-30, 30, (50, 3))
        knots = q @ made.knots_from_mm[:, :3].T + made.knots_from_mm[:, 3] + 1.0
        found.append(ndimage.map_coordinates(made.coefficients[0], knots.T, order=3, prefilter=False))
    apart = np.abs(found[0] - found[1])
    # equally near surface voxels are taken in another order: between two walls the distance may differ
    assert np.median(apart) < 0.01
    assert apart.max() < 0.5
