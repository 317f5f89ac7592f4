"""From surfaces to a model and its check, on beating spheres."""

from dataclasses import replace

import numpy as np
import pytest

from dvf_ig.core import FrameMismatchError, InvalidInputError, Mesh, SurfaceSeries
from dvf_ig.kernels.spline import spline_batch
from dvf_ig.preop import ModelOptions, build_model, check_model, close_surface, model_from_surfaces
from dvf_ig.preop.build import border_distance_mm, end_systole, potential_at_border
from dvf_ig.preop.knots import choose_knot_spacing


@pytest.fixture(scope="module")
def model(beating_sphere):
    return model_from_surfaces(beating_sphere, sources=("balls",))


def test_model_describes_the_surface(model, beating_sphere):
    assert model.patient_id == "ball"
    assert model.surface_name == "EPICARDIAL"
    assert model.frame == "mr"
    assert model.ed_phase == 0
    assert model.es_fraction == 0.3
    assert model.sources == ("balls",)
    assert np.array_equal(model.reference[1].vertices_mm, beating_sphere.vertices_mm[1])


@pytest.mark.parametrize("turned", [0, 3, -4])
def test_end_systole_is_the_middle_of_a_long_flat_minimum(turned: int) -> None:
    flat = np.array([1.0, 0.8, 0.5, 0.2, 0.02, 0.04, 0.03, 0.0, 0.3, 0.6, 0.7, 0.9])
    fractions = np.arange(12) / 12
    middle = (5.5 + turned) / 12 % 1.0
    assert end_systole(np.roll(flat, turned), fractions) == pytest.approx(middle)
    short = np.where(np.arange(12) == 5, 0.1, flat)  # no longer flat: the smallest
    assert end_systole(np.roll(short, turned), fractions) == pytest.approx((7 + turned) / 12 % 1.0)
    assert end_systole(np.ones(12), fractions) == 0.0


def test_a_heart_in_cm_is_no_model(beating_sphere: SurfaceSeries) -> None:
    in_cm = replace(beating_sphere, vertices_mm=0.1 * beating_sphere.vertices_mm)
    with pytest.raises(InvalidInputError, match=r"is 4 mm across.*it is in cm \(then 40 mm\)"):
        model_from_surfaces(in_cm)


def test_distance_and_gradient_of_each_phase_are_those_of_the_sphere(model):
    rng = np.random.default_rng(5)
    direction = rng.normal(size=(400, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for phase, radius in enumerate((20.0, 17.0, 18.5)):
        depth = rng.uniform(-8, 8, size=400)
        points = direction * (radius - depth)[:, None]
        value, gradient, status = np.empty(400), np.empty((400, 3)), np.empty(400, dtype=np.int64)
        spline_batch(
            model.coefficients, model.origin_mm, model.knot_spacing_mm, phase, points, value, gradient, status
        )
        assert (status == 0).all()
        np.testing.assert_allclose(value, depth, atol=0.05)
        assert np.abs(value - depth).mean() < 0.03
        np.testing.assert_allclose(gradient, -direction, atol=0.05)


def test_check_measures_the_fit(model):
    result = check_model(model, points_per_phase=500, rng=np.random.default_rng(1))
    assert result.mean_mm < 0.02
    assert result.mean_mm <= result.p99_mm <= result.max_mm < 0.1
    assert result.per_phase_mm.shape == (3,)
    assert result.points == 1500
    assert result.excluded_area_share == 0.0
    again = check_model(model, points_per_phase=500, rng=np.random.default_rng(1))
    assert again.mean_mm == result.mean_mm


def test_check_measures_normals_against_the_sphere(model):
    result = check_model(model, points_per_phase=800, rng=np.random.default_rng(2))
    assert result.normal_median_deg < 0.3
    assert result.normal_median_deg < result.normal_p95_deg < 1.5
    assert result.facet_normal_median_deg > result.normal_median_deg
    assert result.per_phase_normal_p95_deg.shape == result.per_phase_p99_mm.shape == (3,)
    assert result.per_phase_p99_mm.max() >= result.p99_mm >= result.per_phase_p99_mm.min()


def test_wanted_accuracy_picks_the_coarsest_knots_that_reach_it(beating_sphere):
    closed = close_surface(beating_sphere)
    meshes, caps = [closed.phase(i) for i in range(3)], [closed.caps] * 3
    choice = choose_knot_spacing(meshes, caps, 0.02, margin_mm=15.0, band_mm=4.0)
    assert choice.phase == 1  # the smallest ball
    *refused, taken = choice.tried
    assert taken.knot_spacing_mm == choice.knot_spacing_mm
    assert taken.mean_mm <= 0.02
    assert taken.p99_mm <= 0.08
    assert all(trial.mean_mm > 0.02 or trial.p99_mm > 0.08 for trial in refused)
    model = model_from_surfaces(beating_sphere, options=ModelOptions(accuracy_mm=0.02))
    assert model.knot_spacing_mm == choice.knot_spacing_mm
    assert check_model(model, points_per_phase=500, rng=np.random.default_rng(1)).mean_mm < 0.02


def test_accuracy_out_of_reach_is_refused():
    """A tetrahedron's edges are sharper than any spline."""
    corners = 8.0 * np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    tetrahedron = Mesh("mr", corners, faces)
    caps = [np.zeros(4, dtype=bool)]
    with pytest.raises(InvalidInputError, match="out of reach: knots every"):
        choose_knot_spacing([tetrahedron], caps, 0.001, margin_mm=2.0, band_mm=2.0)


def test_check_finds_a_model_that_is_off(model, beating_sphere):
    moved = [beating_sphere.phase(i) for i in (1, 2, 0)]
    wrong = build_model(
        moved, model.reference_caps, model.timing, patient_id="ball", surface_name="EPICARDIAL"
    )
    swapped = type(model)(
        **{f: getattr(model, f) for f in model.__slots__ if f not in ("coefficients", "origin_mm")},
        coefficients=wrong.coefficients,
        origin_mm=wrong.origin_mm,
    )
    result = check_model(swapped, points_per_phase=500, rng=np.random.default_rng(1))
    np.testing.assert_allclose(result.per_phase_mm, [3.0, 1.5, 1.5], atol=0.05)


def test_caps_are_marked_and_with_their_rim_not_judged(beating_sphere, caplog):
    vertices = beating_sphere.vertices_mm
    low = vertices[0][beating_sphere.triangles].mean(axis=1)[:, 2] < 12.0
    opened = SurfaceSeries(
        "EPICARDIAL", "mr", vertices, beating_sphere.triangles[low], beating_sphere.timing, "x"
    )
    with caplog.at_level("WARNING", "dvf_ig"):
        model = model_from_surfaces(opened)
    (told,) = model.sources
    assert told in caplog.text
    assert told.startswith("surface EPICARDIAL is closed by 1 cap, not measured, of 26% of the measured area")
    assert model.reference_caps[0].any()
    result = check_model(model, points_per_phase=1000, rng=np.random.default_rng(1))
    assert 0.15 < result.excluded_area_share < 0.5
    assert result.p99_mm < 0.1


def test_result_does_not_depend_on_threads(beating_sphere):
    one = model_from_surfaces(beating_sphere, options=ModelOptions(threads=1))
    three = model_from_surfaces(beating_sphere, options=ModelOptions(threads=3))
    assert np.array_equal(one.coefficients, three.coefficients)


def test_force_has_vanished_at_the_border(model):
    assert border_distance_mm(model) >= 15.0
    assert potential_at_border(15.0, 1.0) < 1e-6


def test_progress_reaches_one(beating_sphere):
    reported: list[float] = []
    model_from_surfaces(beating_sphere, progress=reported.append)
    assert reported == pytest.approx([1 / 3, 2 / 3, 1.0])


def test_open_surfaces_are_refused(beating_sphere):
    closed = close_surface(beating_sphere)
    meshes = [closed.phase(i) for i in range(3)]
    torn = [type(m)(m.frame, m.vertices_mm, m.triangles[1:]) for m in meshes]
    caps = [closed.caps[1:]] * 3
    with pytest.raises(InvalidInputError, match="phase 0 is not closed: 3 open edges"):
        build_model(torn, caps, closed.timing, patient_id="x", surface_name="EPICARDIAL")


def test_counts_and_frames_are_checked(beating_sphere):
    meshes = [beating_sphere.phase(i) for i in range(3)]
    caps = [beating_sphere.caps] * 3
    with pytest.raises(InvalidInputError, match="2 surfaces for 3 phases"):
        build_model(meshes[:2], caps, beating_sphere.timing, patient_id="x", surface_name="S")
    with pytest.raises(FrameMismatchError):
        build_model(meshes, caps, beating_sphere.timing, patient_id="x", surface_name="S", frame="ct")


@pytest.mark.parametrize(
    "bad",
    [{"knot_spacing_mm": 0.0}, {"margin_mm": -1.0}, {"band_mm": 0.0}, {"threads": 0}, {"accuracy_mm": 0.0}],
)
def test_options_are_checked(bad):
    with pytest.raises(InvalidInputError):
        ModelOptions(**bad)
