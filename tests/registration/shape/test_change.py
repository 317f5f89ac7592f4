"""A change of shape is found where the boundary shows one, with size and uncertainty; else none is."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.core import CycleTiming, FloatArray, Grid, Points, Rigid, TouchedPoints, VolumeSeries
from dvf_ig.kernels.warp import LARGEST_MM2
from dvf_ig.registration import BLOOD, WALL, BoundaryTarget, target_from_labels
from dvf_ig.registration.boundary.fit import Boundary
from dvf_ig.registration.boundary.points import BoundaryPoints
from dvf_ig.registration.pose_chart import PoseChart, rigid_motion
from dvf_ig.registration.shape.change import Halves, ShapeChange, change_of_shape
from dvf_ig.registration.shape.estimate import AS_IN_MODEL, Contraction, ShapeEstimate
from dvf_ig.registration.shape.modes import shape_modes

CENTER = np.array([5.0, -10.0, 20.0])
CHAMBERS = (
    (CENTER + np.array([24.0, 0.0, 0.0]), np.array([20.0, 24.0, 38.0])),
    (CENTER - np.array([24.0, 0.0, 4.0]), np.array([16.0, 30.0, 30.0])),
)
"""Middle and radii of two chambers of blood."""
TURN = Rotation.from_euler("xyz", [0.3, -0.5, 0.8]).as_matrix()
POSE = Rigid("mr", "tracker", TURN, np.array([3.0, -40.0, 9.0]))
PRESSED = CENTER + np.array([24.0, -24.0, 0.0])
"""Where a retractor presses: the front of the left chamber. The right one is fuller."""


BEATS_MM = 6.0
"""How far the walls of a beating heart move inwards at systole."""


OUTER_MM = 8.0
"""Thickness of the walls."""


@lru_cache(maxsize=3)
def _target(*, beating: bool = False, outer: bool = False) -> BoundaryTarget:
    """Two ellipsoids of blood, each within a wall, or their outer surface; if they beat, also contracted."""
    grid = Grid.axis_aligned("mr", (72, 56, 64), CENTER - np.array([71.0, 55.0, 63.0]), 2.0)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), axis=-1)
    places = grid.to_mm(index.reshape(-1, 3).astype(np.float64))
    labels = np.zeros((2, len(places)), dtype=np.uint8)
    for phase, inward_mm in enumerate((0.0, BEATS_MM if beating else 0.0)):
        for label, wall_mm in ((BLOOD if outer else WALL, OUTER_MM), (BLOOD, 0.0)):
            for middle, radii in CHAMBERS:
                within = np.linalg.norm((places - middle) / (radii + wall_mm - inward_mm), axis=1) < 1.0
                labels[phase, within] = label
    timing = CycleTiming(np.array([0.0, 0.5]), 0.8)
    used = timing.fractions if beating else np.zeros(1)
    return target_from_labels(VolumeSeries(grid, labels.reshape(2, *grid.shape), timing), used)


def _pressed_mm(places_mm: FloatArray) -> FloatArray:
    """(n, 3) displacement: a wall pressed in by 8 mm over 25 mm, and 4 mm outwards beside it."""
    apart = ((places_mm - PRESSED) ** 2).sum(axis=1)
    pressed = 8.0 * np.exp(-0.5 * apart / 25.0**2)[:, None] * np.array([0.0, 1.0, 0.0])
    away = places_mm - CHAMBERS[1][0]
    share = np.exp(-0.5 * (away**2).sum(axis=1) / 35.0**2)[:, None]
    return np.asarray(pressed + 0.2 * share * away)


def _on_wall(count: int, rng: np.random.Generator, inward_mm: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """(n, 3) points of the seen part of both chambers, all but their backs, and outward normals."""
    places, normals = [], []
    for middle, at_rest in CHAMBERS:
        radii = at_rest - inward_mm
        unit = rng.normal(size=(count // 2, 3))
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        unit[unit[:, 1] > 0.6] *= -1.0
        normal = unit / radii
        places.append(middle + radii * unit)
        normals.append(normal / np.linalg.norm(normal, axis=1, keepdims=True))
    return np.concatenate(places), np.concatenate(normals)


def _across(normal: FloatArray) -> FloatArray:
    """(n, 3) unit vectors at right angles to normals."""
    across = np.cross(normal, np.array([0.3, 0.5, 0.8]))
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))


def _boundary(seed: int, *, pressed: float) -> Boundary:
    """Noisy boundary points of 0.7 mm with 5 % outliers, in the tracker's frame."""
    rng = np.random.default_rng(seed)
    wall, normal = _on_wall(1200, rng)
    seen = wall + pressed * _pressed_mm(wall)
    off = rng.normal(scale=0.7, size=len(seen))
    off[rng.random(len(off)) < 0.05] += 5.0
    back = POSE.inverse()
    points = BoundaryPoints(
        "tracker",
        back.apply_array(seen + off[:, None] * normal),
        normal @ back.rotation.T,
        _across(normal) @ back.rotation.T,
        1e-3 * (np.arange(len(seen)) // 50 % 2),  # frames of 50 points
        np.ones(len(seen)),
    )
    return Boundary(points, _target())


def _beating_boundary(seed: int, contraction: float) -> Boundary:
    """Points, to 0.4 mm, of a heart that contracts so many times as far as its model, at both phases."""
    rng = np.random.default_rng(seed)
    rest, moved = (_on_wall(1200, rng, inward) for inward in (0.0, contraction * BEATS_MM))
    wall, normal = (np.concatenate(both) for both in zip(rest, moved, strict=True))
    seen = wall + rng.normal(scale=0.4, size=(len(wall), 1)) * normal
    back = POSE.inverse()
    points = BoundaryPoints(
        "tracker",
        back.apply_array(seen),
        normal @ back.rotation.T,
        _across(normal) @ back.rotation.T,
        np.repeat([0.0, 0.5], len(wall) // 2),
        np.ones(len(wall)),
    )
    return Boundary(points, _target(beating=True))


@pytest.mark.parametrize("contraction", [0.5, 1.3])
def test_a_heart_that_contracts_otherwise_is_told_from_one_of_another_shape(contraction: float) -> None:
    change = change_of_shape(_beating_boundary(1, contraction), 0.0, POSE, CENTER)
    assert change is not None
    found = change.estimate.contraction
    assert found.factor == pytest.approx(contraction, abs=1.96 * found.sigma)
    assert change.warp.contraction == found.factor
    assert f"contracts {found.factor:.2f} times as far" in change.sentence
    assert change.seen_mm < 0.5, "its shape at rest is that of the model"
    off = change.warp.at(_on_wall(400, np.random.default_rng(2))[0])
    assert np.sqrt(np.median(off[1])) > found.sigma * BEATS_MM, "in σ, where it is known least"


def test_a_heart_that_contracts_as_in_its_model_is_not_said_to_contract_otherwise() -> None:
    change = change_of_shape(_beating_boundary(1, 1.0), 0.0, POSE, CENTER)
    assert change is None or change.estimate.contraction is AS_IN_MODEL


def test_beats_of_a_heart_that_contracts_otherwise_are_compared_with_how_it_contracts() -> None:
    boundary = _beating_boundary(1, 0.5)
    change = change_of_shape(boundary, 0.0, POSE, CENTER)
    assert change is not None
    beat = change.estimate.corrected(_beating_boundary(2, 0.5).points, POSE)
    assert beat.contraction == change.estimate.contraction
    rest = _on_wall(400, np.random.default_rng(3))[0]
    assert np.abs(beat.warp.at(rest)[0] - change.warp.at(rest)[0]).max() < 0.5
    assert beat.walls.variance_mm2 < change.estimate.walls.variance_mm2


def _change(seed: int, *, pressed: float) -> ShapeChange | None:
    return change_of_shape(_boundary(seed, pressed=pressed), 0.0, POSE, CENTER)


class _Images:
    """Blocks of images that show where tissue has gone, also behind the seen walls, to 0.8 mm."""

    def places_mm(self, pose: Rigid) -> FloatArray:
        edge = 30.0 * np.arange(-2, 3)
        return CENTER + np.stack(np.meshgrid(edge, edge, edge), axis=-1).reshape(-1, 3)

    def similarity_expansion(self, pose: Rigid, shift_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        assert pose is POSE
        information = np.eye(3) / 0.8**2
        gradient = (shift_mm + _pressed_mm(self.places_mm(pose))) @ information
        return gradient, np.repeat(information[None], len(shift_mm), axis=0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_unchanged_heart_stays_rigid(seed: int) -> None:
    assert _change(seed, pressed=0.0) is None


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_pressed_wall_is_found_where_it_is(seed: int) -> None:
    change = _change(seed, pressed=1.0)
    assert change is not None
    wall, normal = _on_wall(800, np.random.default_rng(100 + seed))
    now = wall + _pressed_mm(wall)
    pulled, variance = change.warp.at(now)
    sigma = np.sqrt(variance)
    without = np.einsum("ni,ni->n", normal, now - wall)
    left = np.einsum("ni,ni->n", normal, now - pulled - wall)
    assert np.sqrt(np.mean(left**2)) < 0.5 * np.sqrt(np.mean(without**2))
    assert 0.4 < np.sqrt(np.mean((left / sigma) ** 2)) < 1.3
    behind = np.sqrt(change.warp.at(CENTER + np.array([[0.0, 45.0, 0.0]]))[1])
    assert behind[0] > 2.0 * np.median(sigma), "what is not seen is not known"


def test_the_error_of_the_guarded_walls_is_stated() -> None:
    change = _change(2, pressed=1.0)
    assert change is not None
    walls = change.estimate.walls
    wall, normal = _on_wall(800, np.random.default_rng(7))
    now = wall + _pressed_mm(wall)
    pulled, variance = change.warp.at(now)
    left = np.einsum("ni,ni->n", normal, now - pulled - wall)[variance <= LARGEST_MM2]
    assert np.mean(left**2) < walls.variance_mm2 < LARGEST_MM2
    assert 1.0 < walls.variance_mm2**2 / walls.square_mm4 < len(left)


def test_images_show_walls_beside_the_boundary_that_is_seen() -> None:
    match: Any = _Images()
    boundary = _boundary(1, pressed=1.0)
    alone = change_of_shape(boundary, 0.0, POSE, CENTER)
    beside = change_of_shape(boundary, 0.0, POSE, CENTER, match=match)
    assert alone is not None
    assert beside is not None
    assert beside.evidence == pytest.approx(alone.evidence, rel=0.1), "of the boundary alone"
    back = CHAMBERS[1][0] + CHAMBERS[1][1] * np.array([[-0.5, 0.8, 0.3], [0.0, 0.9, -0.4], [0.4, 0.9, 0.1]])
    now = back + _pressed_mm(back)
    (pulled, variance), (known, known_mm2) = alone.warp.at(now), beside.warp.at(now)
    assert np.linalg.norm(now - known - back) < 0.6 * np.linalg.norm(now - pulled - back)
    assert (known_mm2 < variance).all()


def _touched_back(seed: int) -> tuple[FloatArray, FloatArray]:
    """(n, 3) points of the outer surface that no image shows, the back of the right chamber; normals."""
    rng, (middle, radii) = np.random.default_rng(seed), CHAMBERS[1]
    unit = rng.normal(size=(400, 3)) + np.array([-1.0, 2.0, 0.0])
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    unit = unit[(unit[:, 1] > 0.6) & (unit[:, 0] < 0.0)][:60]
    normal = unit / (radii + OUTER_MM)
    return middle + (radii + OUTER_MM) * unit, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _moved_mm(places_mm: FloatArray) -> FloatArray:
    """(n, 3) displacement with the back of the right chamber 5 mm further back."""
    middle, radii = CHAMBERS[1]
    apart = ((places_mm - middle - [0.0, radii[1] + OUTER_MM, 0.0]) ** 2).sum(axis=1)
    return _pressed_mm(places_mm) + 5.0 * np.exp(-0.5 * apart / 20.0**2)[:, None] * np.array([0.0, 1.0, 0.0])


def test_touched_points_show_walls_that_no_image_shows() -> None:
    boundary, organ = _boundary(1, pressed=1.0), _target(outer=True)
    wall, normal = _touched_back(2)
    noisy = wall + _moved_mm(wall) + np.random.default_rng(3).normal(scale=0.4, size=(len(wall), 1)) * normal
    touched = TouchedPoints(Points("tracker", POSE.inverse().apply_array(noisy)), 0.0, sigma_mm=0.5)
    alone = change_of_shape(boundary, 0.0, POSE, CENTER, organ)
    beside = change_of_shape(boundary, 0.0, POSE, CENTER, organ, touched=touched)
    assert alone is not None
    assert beside is not None
    back, outward = _touched_back(4)
    now = back + _moved_mm(back)
    left = [np.einsum("ni,ni->n", now - back - change.warp.at(now)[0], outward) for change in (alone, beside)]
    assert np.sqrt(np.mean(left[1] ** 2)) < 0.4 * np.sqrt(np.mean(left[0] ** 2))
    assert (beside.warp.at(now)[1] < alone.warp.at(now)[1]).all()


def test_a_change_is_said_in_words() -> None:
    change = _change(1, pressed=1.0)
    assert change is not None
    pressed = PRESSED + _pressed_mm(PRESSED[None])
    assert change.warp.at(pressed)[0][0, 1] > 3.0, "pressed backwards by 8 mm, less the pose's part"
    assert abs(change.shift_mm) > 3.0
    way = "out" if change.shift_mm > 0 else "in"
    assert f"the {change.wall} wall lies {abs(change.shift_mm):.1f} mm further {way}" in change.sentence
    assert change.refusal is None


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"shared": 0.8}, "no shape explains"),
        ({"halves": Halves(1.01, 0.3)}, "held out"),
        ({"halves": Halves(0.5, 1.1)}, "half of the frames"),
    ],
)
def test_what_the_model_cannot_hold_is_refused_by_name(changed: dict[str, Any], words: str) -> None:
    change = _change(1, pressed=1.0)
    assert change is not None
    assert words in str(replace(change, **changed).refusal)


def test_a_change_explains_frames_that_were_held_out() -> None:
    """Below 1 even of points of which each has its own noise."""
    change = _change(1, pressed=0.5)
    assert change is not None
    assert change.refusal is None
    assert change.halves is not None
    assert change.halves.held_out < 0.8
    assert change.halves.apart_mm < 1.0


def test_fixtures_follow_what_the_margins_of_an_unchanged_heart_do_not_hold() -> None:
    change = _change(1, pressed=1.0)
    assert change is not None
    assert change.followed is change.warp
    small = replace(change, seen_mm=0.99, shared=0.8)
    assert (small.followed, small.refusal) == (None, None)
    assert replace(change, shared=0.8).followed is None


def test_a_small_change_is_followed_if_systole_shows_the_same_as_the_rest_of_the_cycle() -> None:
    change = _change(1, pressed=1.0)
    assert change is not None
    for apart_mm, followed in ((0.4, change.warp), (0.6, None)):
        small = replace(change, seen_mm=0.9, phases=Halves(0.9, apart_mm))
        assert (small.followed, small.refusal) == (followed, None)


def _off_mm(estimate: ShapeEstimate, motion: Rigid) -> tuple[FloatArray, FloatArray]:
    """(n,) errors of the seen walls of a pressed heart that has moved, and their standard deviations."""
    wall, normal = _on_wall(800, np.random.default_rng(100))
    now = motion.apply_array(wall + _pressed_mm(wall))
    pulled, variance = estimate.warp.at(now)
    return np.einsum("ni,ni->n", normal, now - pulled - wall), np.sqrt(variance)


def test_beats_follow_the_heart_and_make_its_walls_surer() -> None:
    change = _change(2, pressed=1.0)
    assert change is not None
    registered = estimate = change.estimate
    assert registered is not None
    step = Rigid("mr", "mr", np.eye(3), np.array([0.2, -0.4, 0.32]))
    moved = Rigid("mr", "mr", np.eye(3), np.zeros(3))
    for beat in range(4):
        moved = step @ moved
        points = _boundary(20 + beat, pressed=1.0).points
        there = (POSE.inverse() @ moved @ POSE).apply_array(points.points_mm)
        estimate = estimate.predicted(2.0).corrected(replace(points, points_mm=there), POSE)
    off_mm, sigma_mm = _off_mm(estimate, moved)
    left_mm, _ = _off_mm(registered, moved)
    assert np.sqrt(np.mean(off_mm**2)) < 0.6 * np.sqrt(np.mean(left_mm**2)), "it has moved by 2.2 mm"
    assert 0.4 < np.sqrt(np.mean((off_mm / sigma_mm) ** 2)) < 1.2
    assert estimate.walls.variance_mm2 < registered.walls.variance_mm2
    assert estimate.corrected(points.subsampled(10), POSE) is estimate, "few points say nothing"


def test_an_estimate_at_another_pose_puts_the_walls_where_they_were() -> None:
    change = _change(1, pressed=1.0)
    assert change is not None
    pose = PoseChart(POSE, CENTER).pose(np.array([0.4, -0.3, 0.5, 0.8, -0.6, 0.7]))
    there = change.estimate.at_pose(POSE, pose)
    wall, _ = _on_wall(200, np.random.default_rng(3))
    at = (pose @ POSE.inverse()).apply_array(wall)
    before, after = wall - change.warp.at(wall)[0], at - there.of(there.posterior).warp.at(at)[0]
    assert np.linalg.norm(after - before, axis=1).max() < 0.4, "modes are those of places 1.4 mm aside"


def test_a_registration_of_frames_that_beats_have_used_makes_an_estimate_no_surer() -> None:
    change, other = _change(1, pressed=1.0), _change(2, pressed=1.0)
    assert change is not None
    assert other is not None
    same = change.estimate.intersected_with(change.estimate)
    np.testing.assert_allclose(same.posterior.state, change.estimate.posterior.state, atol=1e-6)
    both = change.estimate.intersected_with(other.estimate)
    least = min(change.estimate.walls.variance_mm2, other.estimate.walls.variance_mm2)
    assert 0.9 * least < both.walls.variance_mm2
    still = Rigid("mr", "mr", np.eye(3), np.zeros(3))
    errors = [
        np.sqrt(np.mean(_off_mm(one, still)[0] ** 2)) for one in (change.estimate, other.estimate, both)
    ]
    assert errors[2] < max(errors[:2])


def test_a_contraction_that_the_model_does_not_hold_is_not_followed() -> None:
    change = _change(1, pressed=1.0)
    assert change is not None
    for factor, held in ((0.0, True), (1.5, True), (-0.1, False), (1.7, False)):
        other = replace(change, estimate=replace(change.estimate, contraction=Contraction(factor, 0.07)))
        assert (other.followed is not None) == held


def test_an_abrupt_change_is_refused() -> None:
    change = _change(1, pressed=1.0)
    assert change is not None
    steep = replace(change.warp, coefficients=4.0 * change.warp.coefficients)
    assert "abruptly" in str(replace(change, estimate=replace(change.estimate, warp=steep)).refusal)


@pytest.mark.parametrize("away_mm", [7.0, 45.0, 300.0])
def test_points_that_fit_another_pose_say_nothing_of_the_shape(away_mm: float) -> None:
    """Nor do few, or none, near the model, as of a probe and a tool that were exchanged."""
    elsewhere = POSE.perturbed_left(np.zeros(3), np.array([0.0, away_mm, 0.0]), CENTER)
    assert change_of_shape(_boundary(1, pressed=0.0), 0.0, elsewhere, CENTER) is None


def test_modes_have_no_rigid_part_and_are_ordered() -> None:
    rng = np.random.default_rng(4)
    walls = CENTER + rng.normal(scale=(19.0, 15.0, 23.0), size=(300, 3))
    modes = shape_modes(walls, CENTER)
    moved = modes.at(walls, 60)
    motion = rigid_motion(walls, CENTER).reshape(-1, 6)
    assert np.abs(motion.T @ moved.reshape(-1, 60)).max() < 1e-6 * len(walls) * np.abs(motion).max()
    strength = np.linalg.norm(moved.reshape(-1, 60), axis=0)
    assert (np.diff(strength) < 1e-9).all()
    along = rng.normal(size=(300, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    total = modes.variance_along(walls, along)
    assert (np.einsum("ni,nik->nk", along, moved) ** 2).sum(axis=1) == pytest.approx(total, abs=0.05)
    assert np.median(total) < 1.0 / 3.0, "of 1 mm RMS in space, on one axis, less the rigid part"
