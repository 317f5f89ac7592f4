"""The heart's motion: incompressible wall, named amplitudes, exact inverse, chambers that pump."""

import numpy as np
import pytest

from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.heart.motion import ES_FRACTION, MotionChange, activation, preset_scale
from data_synth.heart.motion_report import MotionReport, inverse_error, jacobian_determinant, motion_report
from data_synth.heart.phantom_motion import read_only_views
from data_synth.kernels import heart_motion, lv
from dvf_ig.core import FloatArray, InvalidInputError

AT_REST = np.zeros((3, 7))
"""No lobes: the motion of the left ventricle alone."""

HEART = (np.eye(3), np.zeros(3), AT_REST, lv.STANDARD_CAVITY)


def forward(points: FloatArray, level: float) -> FloatArray:
    out, (points, *heart) = np.empty_like(points), read_only_views(points, *HEART)
    heart_motion.forward(points, np.full(len(points), level), *heart, out)
    return out


def determinant(points: FloatArray, level: float) -> FloatArray:
    h = 1e-3
    columns = []
    for e in h * np.eye(3):
        near = forward(points + e, level) - forward(points - e, level)
        far = forward(points + 2 * e, level) - forward(points - 2 * e, level)
        columns.append((8 * near - far) / (12 * h))
    return np.linalg.det(np.stack(columns, axis=-1))


def ring(height: FloatArray, radius: FloatArray, angle: FloatArray) -> FloatArray:
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


@pytest.fixture(scope="module")
def wall() -> FloatArray:
    """Random points of the left-ventricular wall, away from its surfaces and the pointed apex."""
    rng = np.random.default_rng(0)
    z = rng.uniform(2.0, 84.9, 4000)
    outer, inner = np.array([lv.radii(h, lv.STANDARD_CAVITY) for h in z]).T
    return ring(z, inner + (outer - inner) * rng.uniform(0.02, 0.98, 4000), rng.uniform(0, 2 * np.pi, 4000))


@pytest.fixture(scope="module")
def report(anatomy: PhantomAnatomy) -> MotionReport:
    return motion_report(anatomy, points=12_000)


@pytest.mark.parametrize("level", [0.1, 0.35, 1.0])
def test_wall_is_incompressible(wall: FloatArray, level: float) -> None:
    assert np.abs(determinant(wall, level) - 1).max() < 1e-9


def test_wall_stays_incompressible_in_the_whole_heart(report: MotionReport) -> None:
    """The flow of the other chambers leaves the wall alone, bit by bit."""
    assert report.wall_det_error < 1e-9


@pytest.mark.parametrize("level", [0.35, 1.0])
def test_left_ventricle_alone_is_invertible(level: float) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-110, -110, -60], [110, 110, 190], (40_000, 3))
    assert determinant(points, level).min() > 0.2
    found = np.empty_like(points)
    given, *heart, still = read_only_views(points, *HEART, np.zeros((0, 0, 0, 3)), np.zeros(3), np.zeros(4))
    heart_motion.inverse(given, np.full(len(points), level), *heart, 1.0, still, found)
    assert np.linalg.norm(forward(found, level) - points, axis=1).max() < 0.006


@pytest.mark.parametrize("mismatch_mm", [0.0, 5.0])
def test_whole_heart_is_invertible(mismatch_mm: float) -> None:
    other = phantom_anatomy(motion="physiological", mismatch_mm=mismatch_mm, seed=3)
    assert inverse_error(other, np.random.default_rng(1), 12_000) < 0.05


def test_inverse_holds_on_both_sides_of_every_crease(anatomy: PhantomAnatomy) -> None:
    """Walls and valve plane, where a table of the inverse would round off; and it does not fold."""
    rng = np.random.default_rng(4)
    z, angle = rng.uniform(0.5, 130, 9000), rng.uniform(0, 2 * np.pi, 9000)
    outer, inner = np.array([lv.radii(h, lv.STANDARD_CAVITY) for h in z]).T
    near = rng.normal(0.0, 0.3, 9000)
    radius = np.abs(np.where(rng.uniform(size=9000) < 0.5, outer, inner) + near)
    there = anatomy.shapes.mr_from_heart.apply_array(ring(z, radius, angle))
    moved = anatomy.mismatch.forward(anatomy.deformed(there, ES_FRACTION))
    assert np.linalg.norm(anatomy.material(moved, ES_FRACTION) - there, axis=1).max() < 0.05
    box = rng.uniform(anatomy.box_mm[0] - 20, anatomy.box_mm[1] + 20, (20_000, 3))
    assert jacobian_determinant(anatomy, box, ES_FRACTION).min() > 0.2


def test_a_still_wall_stands_and_its_motion_is_invertible(anatomy: PhantomAnatomy) -> None:
    sick = anatomy.changed(1.2, 1, motion_change=MotionChange(still_mm=50.0))
    assert sick.still is not None
    rng = np.random.default_rng(8)
    box = rng.uniform(anatomy.box_mm[0] - 20, anatomy.box_mm[1] + 20, (20_000, 3))
    motion = sick.present_motion
    apart = np.linalg.norm(box - sick.still.center_mm, axis=1)
    moved, healthy = motion.push_forward(box, ES_FRACTION), anatomy.deformed(box, ES_FRACTION)
    assert np.linalg.norm(moved - box, axis=1)[apart < 5].max() < 0.4
    np.testing.assert_array_equal(moved[apart > 50], healthy[apart > 50])
    step = 1e-3 * np.eye(3)
    columns = [
        (motion.push_forward(box + h, ES_FRACTION) - motion.push_forward(box - h, ES_FRACTION)) / 2e-3
        for h in step
    ]
    assert np.linalg.det(np.stack(columns, axis=-1)).min() > 0.15
    back = sick.mismatch.forward(motion.push_forward(sick.material(box, ES_FRACTION), ES_FRACTION))
    assert np.linalg.norm(back - box, axis=1).max() < 0.05


def test_the_mr_of_a_heart_that_moves_otherwise_shows_its_motion_before(anatomy: PhantomAnatomy) -> None:
    weak = anatomy.changed(0.0, 1, motion_change=MotionChange(contraction=0.6))
    before, now = anatomy.resting_motion, weak.inverse_motion
    np.testing.assert_allclose(now.levels(ES_FRACTION, 1), 0.6 * before.levels(ES_FRACTION, 1))
    vertices = anatomy.ed_vertices_mm
    np.testing.assert_array_equal(
        weak.deformed(vertices, ES_FRACTION), anatomy.deformed(vertices, ES_FRACTION)
    )
    there = weak.surface_vertices(ES_FRACTION)
    assert np.linalg.norm(weak.material(there, ES_FRACTION) - vertices, axis=1).max() < 0.05
    with pytest.raises(InvalidInputError, match="fold space"):
        MotionChange(still_mm=20.0)


def test_phases_may_differ_from_point_to_point(anatomy: PhantomAnatomy) -> None:
    rng = np.random.default_rng(5)
    points, phases = rng.uniform(*anatomy.box_mm, (40, 3)), rng.uniform(0, 1, 40)
    together = anatomy.inverse_motion.pull_back(points, phases)
    alone = [anatomy.material(p[None], float(phase))[0] for p, phase in zip(points, phases, strict=True)]
    # the search stops at 5 µm, and starts elsewhere when a point is alone
    assert np.abs(together - np.array(alone)).max() < 0.03


def test_chambers_pump_like_those_of_a_heart(report: MotionReport) -> None:
    """Normal ranges: LVEF 0.55-0.70, RVEF 0.45-0.60, wall thickening 0.3-0.6, long axis 0.13-0.2."""
    assert 0.60 < report.lv_ejection_fraction < 0.66
    assert 0.45 < report.rv_ejection_fraction < 0.55
    assert report.la_expansion > 0.25
    assert 0.3 < report.wall_thickening < 0.6
    assert report.long_axis_shortening == pytest.approx(0.16, abs=1e-6)
    assert report.largest_lv_motion_mm == pytest.approx(13.9, abs=0.03)
    assert report.largest_surface_motion_mm == pytest.approx(13.9, abs=0.8)
    assert report.inverse_error_mm < 0.05
    assert 0.2 < report.det_min < 1 < report.det_max < 2.5


def test_left_atrium_is_largest_at_end_systole(anatomy: PhantomAnatomy) -> None:
    center, semi = anatomy.shapes.heart.la_center, anatomy.shapes.heart.la_semi
    rng = np.random.default_rng(6)
    ball = rng.normal(size=(800, 3))
    ball *= rng.uniform(0, 0.85, (800, 1)) ** (1 / 3) / np.linalg.norm(ball, axis=1, keepdims=True)
    blood = anatomy.shapes.mr_from_heart.apply_array(center + ball * semi)
    volumes = [jacobian_determinant(anatomy, blood, phase).mean() for phase in np.linspace(0, 0.96, 25)]
    assert np.linspace(0, 0.96, 25)[int(np.argmax(volumes))] == pytest.approx(ES_FRACTION)


def test_annuli_and_appendage_move_with_the_heart(anatomy: PhantomAnatomy) -> None:
    targets = anatomy.targets()
    moved = anatomy.deformed(targets.points.xyz_mm, ES_FRACTION) - targets.points.xyz_mm
    axis = anatomy.shapes.mr_from_heart.rotation[:, 2]
    for name, low, high in (
        ("mitral_lateral", 11, 15),
        ("mitral_anterior", 11, 15),
        ("tricuspid_lateral", 5, 14),
    ):
        assert low < -moved[targets.names.index(name)] @ axis < high
    assert np.linalg.norm(moved[targets.names.index("apex")]) < 0.5
    assert 1.0 < np.linalg.norm(moved[targets.names.index("laa_tip")]) < 14.0


@pytest.mark.parametrize(("motion", "largest_mm"), [("physiological", 13.9), ("paper5mm", 4.96)])
def test_named_motions_have_their_epicardial_amplitude(motion: str, largest_mm: float) -> None:
    z, angle = (g.ravel() for g in np.meshgrid(np.linspace(0, lv.BASE, 200), np.linspace(0, 2 * np.pi, 60)))
    epicardium = ring(z, np.array([lv.outer_radius(h) for h in z]), angle)
    moved = np.linalg.norm(forward(epicardium, preset_scale(motion)) - epicardium, axis=1)
    assert moved.max() == pytest.approx(largest_mm, abs=0.03)


def test_ejection_fraction_of_the_closed_form() -> None:
    z = np.linspace(lv.CAVITY_APEX, lv.BASE, 2000)
    inner = np.array([lv.radii(h, lv.STANDARD_CAVITY)[1] for h in z])
    rim = forward(ring(z, inner, np.zeros_like(z)), 1.0)
    radius = np.hypot(rim[:, 0], rim[:, 1])
    filled, emptied = np.trapezoid(inner**2, z), np.trapezoid(radius**2, rim[:, 2])
    assert 1 - emptied / filled == pytest.approx(0.64, abs=0.005)


def test_motion_is_continuous_across_every_seam() -> None:
    """Endocardium, epicardium, cavity apex, apex and base: no jump larger than the step taken across."""
    rng = np.random.default_rng(2)
    z, angle = rng.uniform(5, 120, 2000), rng.uniform(0, 2 * np.pi, 2000)
    outer, inner = np.array([lv.radii(h, lv.STANDARD_CAVITY) for h in z]).T
    step = 1e-6
    for radius in (outer, inner):
        gap = forward(ring(z, radius + step, angle), 1.0) - forward(ring(z, radius - step, angle), 1.0)
        assert np.linalg.norm(gap, axis=1).max() < 1e-4
    for height in (0.0, lv.CAVITY_APEX, lv.BASE):
        radius = rng.uniform(0.5, 80, 2000)
        low = forward(ring(np.full(2000, height - step), radius, angle), 1.0)
        high = forward(ring(np.full(2000, height + step), radius, angle), 1.0)
        # the pointed apex has an infinite slope in R_o(Z): there the gap shrinks with the root of the step
        assert np.linalg.norm(high - low, axis=1).max() < (2e-2 if height == 0.0 else 1e-4)


def test_activation_is_periodic_smooth_and_peaks_at_end_systole() -> None:
    phase = np.linspace(0, 1, 2001)
    level = activation(phase)
    assert activation(0.0) == pytest.approx(activation(1.0), abs=1e-12)
    assert phase[level.argmax()] == pytest.approx(ES_FRACTION, abs=1e-3)
    assert level.min() >= 0
    assert level.max() == pytest.approx(1.0)
    slope = np.diff(level) / np.diff(phase)
    assert abs(slope[0] - slope[-1]) < 0.05


def test_unknown_motion_lists_the_choices() -> None:
    with pytest.raises(InvalidInputError, match="paper5mm"):
        preset_scale("fast")
