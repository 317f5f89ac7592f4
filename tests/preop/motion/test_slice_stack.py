"""Stacks of short-axis slices: what their header says, and where they end within the heart."""

from dataclasses import replace

import numpy as np
import pytest
from short_axis_toy import CAVITY, WALL, contracting_stack

from dvf_ig.core import CycleTiming, Grid, InvalidInputError, Mesh, Volume, VolumeSeries
from dvf_ig.preop import dice, propagate_labels, track_cycle
from dvf_ig.preop.cine_model import _chamber, _Moving
from dvf_ig.preop.motion.base_descent import BaseDescent, propagate_through, unknown_descent
from dvf_ig.preop.motion.cycle import CycleMotion
from dvf_ig.preop.motion.demons import DisplacementField
from dvf_ig.preop.motion.free_form import FreeForm, Lattice
from dvf_ig.preop.motion.open_ends import seen_part
from dvf_ig.preop.motion.quality import assess_motion
from dvf_ig.preop.motion.slice_phases import retimed, slice_phases
from dvf_ig.preop.motion.slice_stack import axis_of_lost_spacing, observable_axes

END_SYSTOLE = 3


@pytest.fixture(scope="module")
def stack():
    return contracting_stack()


def without_spacing(image: VolumeSeries) -> VolumeSeries:
    """As cines come whose header says 1 mm along every axis."""
    return VolumeSeries(
        Grid.axis_aligned("mr", image.grid.shape, np.zeros(3), 1.0), image.values, image.timing
    )


@pytest.mark.parametrize(
    ("missing", "heights_mm"),
    [
        ([], [[-43.5, 0.5]]),
        ([4], [[-33.5, 0.5]]),
        ([2], [[-43.5, -29.5], [-13.5, 0.5]]),
        ([2, 4], [[-33.5, -29.5], [-13.5, 0.5]]),
    ],
)
def test_what_slices_show_ends_where_they_or_their_labels_end(stack, missing, heights_mm):
    """The base up to slice 0, the apex down to the last slice that shows it."""
    image, labels = stack
    organ = labels[0] > 0
    organ[:, :, missing] = False
    shift = np.zeros((5, 3))
    shift[:, 2] = -1.5
    descent = unknown_descent(image.grid, organ, np.array([5.0, 5.0, 3.0, 1.0, 3.0, 5.0]))
    found = seen_part(image.grid, organ, shift, descent)
    assert found is not None
    np.testing.assert_allclose(found.normal, [0.0, 0.0, -1.0])
    # slice k shows the heart at z = 10 k + 1.5 and 2 mm on either side; the base is at z = 0, heights are −z
    np.testing.assert_allclose(found.bounds_mm[0], heights_mm)
    np.testing.assert_allclose(found.bounds_mm[3], heights_mm)
    # without a view the base is uncertain by the descent of adults, in the course of the volume
    np.testing.assert_allclose(found.sigma_mm, np.hypot(12.0, 3.0) * np.array([0.0, 0.0, 0.5, 1.0, 0.5, 0.0]))
    assert seen_part(image.grid, organ, shift, None) is None


def test_slices_of_other_heart_rates_are_aligned_at_their_end_systole():
    """Radial motion whose systole takes another share of each slice's cycle; a knot plane is a slice."""
    phases, own_es = 24, np.array([0.35, 0.39, 0.31, 0.35, 0.36])
    grid = Grid.axis_aligned("mr", (24, 24, 5), np.zeros(3), np.array([2.0, 2.0, 10.0]))
    lattice = Lattice.over(grid, np.array([6.0, 6.0, 10.0]))
    timing = CycleTiming.uniform(phases, 0.9)

    def course(es):
        since = np.interp(timing.fractions, [0.0, es, 1.0], [0.0, 0.5, 1.0])
        return np.sin(np.pi * since) ** 2

    knots = np.stack(
        np.meshgrid(*((np.arange(n) - 1) * 6.0 - 23.0 for n in lattice.shape[:2]), indexing="ij"), -1
    )
    # control points with which each slice has its own course
    from_points = sum(np.eye(5, 7, k) * share for k, share in enumerate((1 / 6, 4 / 6, 1 / 6)))
    courses = np.linalg.lstsq(from_points, np.array([course(es) for es in own_es]))[0]
    deformations = []
    for i in range(phases):
        coefficients = np.zeros((*lattice.shape, 3))
        coefficients[..., :2] = -0.2 * courses[:, i, None] * knots[:, :, None]
        deformations.append(FreeForm(lattice, coefficients))
    disc = np.zeros(grid.shape, dtype=np.bool_)
    disc[7:17, 7:17] = True
    still = np.array([True, True, False])
    motion = CycleMotion(0, tuple(deformations), 12, deformations[12], (0, 0, 0), disc, still)
    found = slice_phases(motion, timing, disc)
    np.testing.assert_allclose(found.es - found.es.mean(), own_es - own_es.mean(), atol=0.012)
    aligned = retimed(motion, timing, found)
    point = np.array([[33.0, 23.0, 10.0 * k] for k in range(5)])
    spread = {
        name: max(np.ptp((point - d.move(point))[:, 0]) for d in one.deformations)
        for name, one in (("index", motion), ("end-systole", aligned))
    }
    assert spread["index"] > 0.4
    assert spread["end-systole"] < 0.2
    first = aligned.deformations[0]
    assert isinstance(first, FreeForm)
    assert not first.coefficients.any()


def test_a_surface_slides_along_the_outlines_that_the_slices_show():
    """A cone that stands still in every plane while its tissue descends: the vertices stay on the cone."""
    grid = Grid.axis_aligned("mr", (60, 60, 6), np.zeros(3), np.array([1.5, 1.5, 10.0]))
    at = grid.centers_mm() - [44.25, 44.25, 0.0]
    cone = np.hypot(at[..., 0], at[..., 1]) < 14.0 + 0.3 * at[..., 2]
    identity = FreeForm.identity(Lattice.over(grid, np.array([6.0, 6.0, 10.0])))
    whole, still = np.ones(grid.shape, dtype=np.bool_), np.array([True, True, False])
    motion = CycleMotion(0, (identity, identity), 1, identity, (0, 0, 0), whole, still)
    image = VolumeSeries(grid, np.zeros((2, *grid.shape)), CycleTiming.uniform(2, 0.9))
    descent = BaseDescent(np.array([0.0, 12.0]), np.array([0.0, 50.0]), np.zeros(2), 1)
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    z = np.array([12.0, 30.0, 45.0])[:, None] + 0.0 * angle
    radius = 14.0 + 0.3 * z
    ring = np.stack([44.25 + radius * np.cos(angle), 44.25 + radius * np.sin(angle), z], axis=-1).reshape(
        -1, 3
    )
    mesh = Mesh("mr", ring, np.array([[0, 1, 2]]))
    moved = propagate_through(motion, image, mesh, cone, descent, "EPICARDIAL").vertices_mm
    np.testing.assert_array_equal(moved[0], ring)
    np.testing.assert_allclose(ring[:, 2] - moved[1][:, 2], 12.0 * ring[:, 2] / 50.0, atol=1e-9)
    off = np.hypot(moved[1][:, 0] - 44.25, moved[1][:, 1] - 44.25) - (14.0 + 0.3 * moved[1][:, 2])
    assert np.abs(off).max() < 0.5
    assert np.abs(off).mean() < 0.25


@pytest.mark.parametrize("lost", [False, True])
def test_labels_follow_a_stack_whatever_its_header_says(stack, lost):
    """Motion across the slices would fit anything, and bring labels in from beyond the ends."""
    image, labels = stack
    image = without_spacing(image) if lost else image
    motion = track_cycle(image, labels[0] > 0)
    assert motion.observable.tolist() == [True, True, False]
    assert motion.spacing_lost is lost
    assert assess_motion(motion, image, labels[0] > 0).slice_pitch_mm == (1.0 if lost else 10.0)
    moved = propagate_labels(motion, image, Volume(image.grid, labels[0]), END_SYSTOLE)
    for k in range(image.grid.shape[2]):
        for value, least in ((WALL, 0.85), (CAVITY, 0.9)):  # outlines half a pixel off, at the apex
            there = labels[END_SYSTOLE, ..., k] == value
            assert dice(moved[..., k] == value, there) > least
            assert dice(moved[..., k] == value, there) > dice(labels[0, ..., k] == value, there) + 0.05


def test_the_slice_pitch_is_seen_in_the_grey_levels():
    image, _ = contracting_stack((1.0, 0.9), noise=0.1)
    apart = without_spacing(image).values[0]
    assert axis_of_lost_spacing(apart, np.ones(3)) == 2
    assert axis_of_lost_spacing(apart.transpose(2, 0, 1), np.ones(3)) == 0
    assert axis_of_lost_spacing(apart, image.grid.spacing_mm) is None
    rng = np.random.default_rng(2)
    assert axis_of_lost_spacing(rng.normal(size=(20, 20, 20)), np.ones(3)) is None
    assert observable_axes(np.array([1.5, 1.5, 2.9])).all()
    assert observable_axes(np.array([1.5, 1.5, 10.0])).tolist() == [True, True, False]


def test_a_chamber_of_which_a_stack_holds_the_end_is_left_out_with_a_warning(stack, caplog):
    image, labels = stack
    motion = track_cycle(image, labels[0] > 0)
    end = np.zeros(image.grid.shape, dtype=np.bool_)
    end[10, 10:12, -1] = True
    assert _chamber(_Moving(motion, image, None, None), end, "left atrium") is None
    assert "too little of left atrium" in caplog.text
    close = Grid.axis_aligned("mr", image.grid.shape, np.zeros(3), 2.0)
    moving = _Moving(motion, VolumeSeries(close, image.values, image.timing), None, None)
    with pytest.raises(InvalidInputError, match="fewer than a surface needs"):
        _chamber(moving, end, "left atrium")


def test_what_comes_in_through_the_end_of_the_stack_is_continued(stack):
    """Tissue that moves one slice towards the apex leaves none without a label behind."""
    image, labels = stack
    still = track_cycle(image, labels[0] > 0)
    down = np.zeros((*still.grid.shape, 3))
    down[..., 2] = 10.0
    field = DisplacementField(still.grid, down)
    moving = replace(still, deformations=(still.deformations[0], *[field] * 5))
    moved = propagate_labels(moving, image, Volume(image.grid, labels[0]), 2)
    assert np.array_equal(moved[..., 1:], labels[0][..., :-1])
    assert np.array_equal(moved[..., 0], labels[0][..., 0])
