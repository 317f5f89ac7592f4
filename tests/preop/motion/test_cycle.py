"""Motion from grey levels against a ball whose motion is known in closed form, and on a real cine."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvf_ig.core import CycleTiming, Grid, InvalidInputError, Volume, VolumeSeries
from dvf_ig.preop import (
    MotionOptions,
    cavity_volumes_mm3,
    dice,
    propagate_labels,
    track_cycle,
)
from dvf_ig.preop.motion.cycle import propagate_surface
from dvf_ig.preop.motion.demons import DisplacementField
from dvf_ig.preop.motion.free_form import Bending, FreeForm, Lattice, volume_ratio
from dvf_ig.preop.motion.image_match import FreeFormOptions
from dvf_ig.preop.motion.quality import assess_motion
from dvf_ig.preop.surface.from_labels import surface_of_mask

OUTER_MM, INNER_MM = 17.0, 10.0
SCALES = (1.0, 0.94, 0.87, 0.84, 0.9, 0.97)
SHIFTS_MM = 3.0 * np.sin(np.pi * np.arange(6) / 6)[:, None] * np.array([0.6, 0.0, 0.8])


def beating_ball(noise: float = 0.05) -> tuple[VolumeSeries, np.ndarray]:
    """A shell around a cavity that shrinks about its centre and shifts; labels 1 wall, 2 cavity."""
    turned = Rotation.from_rotvec([0.2, -0.3, 0.4]).as_matrix()
    half = 13
    corner = -turned @ np.full(3, half * 2.0)
    grid = Grid("mr", (2 * half + 1,) * 3, corner, np.full(3, 2.0), turned)
    rng = np.random.default_rng(11)
    centers = grid.centers_mm()
    images, labels = [], []
    for scale, shift in zip(SCALES, SHIFTS_MM, strict=True):
        q = (centers - shift) / scale
        r = np.linalg.norm(q, axis=-1)
        grey = 0.3 + 0.5 / (1 + np.exp((r - INNER_MM) / 0.7)) - 0.2 / (1 + np.exp((OUTER_MM - r) / 0.7))
        grey = grey + 0.06 * np.sin(q @ [0.5, 0.2, 0.1]) * np.cos(q @ [-0.1, 0.4, 0.3])
        images.append(grey + noise * rng.standard_normal(grey.shape))
        labels.append(np.where(r < INNER_MM, 2, np.where(r < OUTER_MM, 1, 0)))
    timing = CycleTiming.uniform(6, 0.9)
    return VolumeSeries(grid, np.stack(images), timing), np.stack(labels).astype(np.uint8)


@pytest.fixture(scope="module")
def ball():
    return beating_ball()


@pytest.fixture(scope="module")
def estimated(ball):
    image, labels = ball
    return track_cycle(image, labels[0] > 0)


def true_motion(estimated):
    """The same, with the true displacement: what voxels alone cost is then known."""
    grid = estimated.grid
    place = grid.centers_mm()
    fields = [
        DisplacementField(grid, ((scale - 1.0) * place + shift) @ grid.direction)
        for scale, shift in zip(SCALES, SHIFTS_MM, strict=True)
    ]
    return replace(estimated, deformations=tuple(fields), meeting=fields[estimated.meeting_phase])


def surface_error_mm(motion, image, labels) -> float:
    surface = surface_of_mask(labels[0] > 0, image.grid)
    series = propagate_surface(motion, image, surface, "BALL", "ball")
    off = [
        np.abs(np.linalg.norm(vertices - shift, axis=1) - OUTER_MM * scale).mean()
        for vertices, scale, shift in zip(series.vertices_mm, SCALES, SHIFTS_MM, strict=True)
    ]
    return float(np.mean(off))


def test_the_propagated_surface_lies_on_the_true_one(ball, estimated):
    image, labels = ball
    assert surface_error_mm(estimated, image, labels) < 0.2
    assert (
        surface_error_mm(replace(estimated, deformations=estimated.deformations[:1] * 6), image, labels) > 1.0
    )


def test_the_evidence_agrees_with_the_truth(ball, estimated):
    image, labels = ball
    quality = assess_motion(estimated, image, labels[0] > 0, labels > 0)
    assert not quality.folds
    assert quality.meeting_phase == 3
    assert quality.closure_mean_mm < 0.3
    assert quality.slice_pitch_mm is None
    assert quality.dice is not None
    assert quality.dice_before is not None
    exact = assess_motion(true_motion(estimated), image, labels[0] > 0, labels > 0).dice
    assert exact is not None
    assert (quality.dice > exact - 0.01).all()
    assert (quality.dice[1:] > quality.dice_before[1:]).all()
    assert (quality.correlation[1:] > quality.correlation_before[1:]).all()
    volumes = cavity_volumes_mm3(estimated, labels[0] == 2)
    np.testing.assert_allclose(volumes / volumes[0], np.array(SCALES) ** 3, rtol=0.06)
    assert volumes.argmin() == 3


def test_labels_are_propagated(ball, estimated):
    image, labels = ball
    known = Volume(image.grid, labels[0])
    moved, exact = (propagate_labels(m, image, known, 3) for m in (estimated, true_motion(estimated)))
    for part in ((1, 2), (2,)):
        truth = np.isin(labels[3], part)
        assert dice(np.isin(moved, part), truth) > dice(np.isin(exact, part), truth) - 0.02
    assert dice(exact > 0, labels[3] > 0) > 0.93
    assert np.array_equal(propagate_labels(estimated, image, Volume(image.grid, labels[0]), 0), labels[0])


def test_the_number_of_threads_changes_nothing(ball, estimated):
    image, labels = ball
    alone = track_cycle(image, labels[0] > 0, options=MotionOptions(threads=1))
    for one, two in zip(alone.deformations, estimated.deformations, strict=True):
        assert np.array_equal(one.on_voxels(), two.on_voxels())


def test_gain_and_offset_of_the_image_change_little(ball, estimated):
    image, labels = ball
    values = image.values * np.linspace(1.0, 1.6, 6).reshape(-1, 1, 1, 1) + 5.0
    scaled = track_cycle(VolumeSeries(image.grid, values, image.timing), labels[0] > 0)
    for one, two in zip(scaled.deformations, estimated.deformations, strict=True):
        np.testing.assert_allclose(one.on_voxels(), two.on_voxels(), atol=1e-4)


def test_another_phase_can_be_the_labelled_one(ball):
    image, labels = ball
    motion = track_cycle(image, labels[3] > 0, ed_phase=3)
    assert not motion.deformations[3].on_voxels().any()
    surface = surface_of_mask(labels[3] > 0, image.grid)
    moved = propagate_surface(motion, image, surface, "BALL", "ball").vertices_mm[0]
    assert np.abs(np.linalg.norm(moved, axis=1) - OUTER_MM).mean() < 0.25


def test_demons_are_a_second_opinion(ball):
    """They stop short where contrast is low, but go the right way and do not fold."""
    image, labels = ball
    motion = track_cycle(image, labels[0] > 0, options=MotionOptions(method="demons"))
    still = replace(motion, deformations=motion.deformations[:1] * 6)
    error_mm = surface_error_mm(motion, image, labels)
    assert error_mm < 0.6 * surface_error_mm(still, image, labels)
    assert not assess_motion(motion, image, labels[0] > 0).folds


@pytest.mark.parametrize("kind", ["lattice", "field"])
def test_points_move_as_voxels_do(kind):
    turned = Rotation.from_rotvec([0.4, 0.1, -0.2]).as_matrix()
    grid = Grid("mr", (9, 8, 7), [3.0, -4.0, 5.0], [2.0, 1.5, 4.0], turned)
    rng = np.random.default_rng(4)
    lattice = Lattice.over(grid, 6.0)
    move: FreeForm | DisplacementField = FreeForm(lattice, rng.normal(size=(*lattice.shape, 3)))
    if kind == "field":
        move = DisplacementField(grid, move.on_voxels())
    points = grid.centers_mm().reshape(-1, 3)
    expected = points + move.on_voxels().reshape(-1, 3) @ turned.T
    np.testing.assert_allclose(move.move(points), expected, atol=1e-9)


def test_lattice_algebra():
    """Adjoint, a stretch reproduced exactly, no bending of straight lines, the Jacobian of a stretch."""
    grid = Grid.axis_aligned("mr", (11, 9, 8), np.zeros(3), (2.0, 2.0, 3.0))
    lattice, rng = Lattice.over(grid, 7.0), np.random.default_rng(3)
    a, b = rng.normal(size=(*lattice.shape, 3)), rng.normal(size=(*grid.shape, 3))
    assert (lattice.on_voxels(a) * b).sum() == pytest.approx((a * lattice.adjoint(b)).sum(), rel=1e-12)
    knots = [(np.arange(n) - 1.0) * p for n, p in zip(lattice.shape, lattice.pitch_mm, strict=True)]
    place = np.stack(np.meshgrid(*knots, indexing="ij"), axis=-1)
    stretch = place * [0.1, -0.2, 0.3]
    np.testing.assert_allclose(lattice.on_voxels(stretch), grid.centers_mm() * [0.1, -0.2, 0.3], atol=1e-12)
    bending = Bending.of(lattice)
    np.testing.assert_allclose(bending.half_gradient(stretch), 0.0, atol=1e-10)
    assert (a * bending.half_gradient(a)).sum() > 0
    unit = np.zeros_like(a)
    unit[2, 3, 1, 0] = 1.0
    assert bending.half_gradient(unit)[2, 3, 1, 0] == pytest.approx(bending.diagonal(lattice)[2, 3, 1, 0])
    moved, everywhere = lattice.on_voxels(stretch), np.ones(grid.shape, dtype=bool)
    ratio = volume_ratio(moved, grid.spacing_mm, everywhere)
    np.testing.assert_allclose(ratio, 1.1 * 0.8 * 1.3, rtol=1e-9)


def test_refusals(ball):
    image, labels = ball
    with pytest.raises(InvalidInputError, match="no voxels at end-diastole"):
        track_cycle(image, labels[0] == 9)
    with pytest.raises(InvalidInputError, match="phases 0 to 5"):
        track_cycle(image, labels[0] > 0, ed_phase=6)
    with pytest.raises(InvalidInputError, match="mask is"):
        track_cycle(image, labels[0, 1:] > 0)
    with pytest.raises(InvalidInputError, match="no contrast"):
        track_cycle(VolumeSeries(image.grid, np.ones_like(image.values), image.timing), labels[0] > 0)
    with pytest.raises(InvalidInputError, match="knot pitch"):
        FreeFormOptions(pitch_mm=1.0)
    with pytest.raises(InvalidInputError, match="motion method"):
        MotionOptions(method="optical")
