"""Fitted surfaces of a real heart: open as they come, closed and modelled here."""

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, Grid, SurfaceSeries
from dvf_ig.io import read_surface_series
from dvf_ig.preop import ModelOptions, caps_of, check_model, close_surface, model_from_surfaces, rasterise
from dvf_ig.preop.build import border_distance_mm
from dvf_ig.preop.surface.closing import MAX_BEYOND_MM, MAX_CAP_SHARE
from dvf_ig.preop.surface.topology import count_edges

PHASES = [0, 9, 17]
OPENINGS = {"EPICARDIAL": 4, "LV_ENDOCARDIAL": 2, "RV_ENDOCARDIAL": 2}


def some_phases(series: SurfaceSeries) -> SurfaceSeries:
    timing = CycleTiming(series.timing.fractions[PHASES], series.timing.rr_s)
    return SurfaceSeries(
        series.name, series.frame, series.vertices_mm[PHASES], series.triangles, timing, series.patient_id
    )


@pytest.fixture(scope="module")
def heart(data_dir):
    folder = data_dir / "bivme-cine"
    if not folder.is_dir():
        pytest.skip(f"no fitted surfaces at {folder}")
    return {name: some_phases(read_surface_series(folder, name)) for name in OPENINGS}


@pytest.mark.parametrize("name", OPENINGS)
def test_every_surface_closes(heart, name):
    closed = close_surface(heart[name])
    assert count_edges(heart[name].triangles).open_edges > 0
    assert count_edges(closed.triangles).closed
    assert closed.vertices_mm.shape[1] - len(np.unique(closed.triangles[~closed.caps])) == OPENINGS[name]
    assert (closed.volumes_mm3() > 0).all()


def test_openings_of_a_real_heart_are_far_within_the_bounds(heart):
    """Valves of up to 40 mm; the bounds leave room for ones twice as large against their ventricle."""
    for series in heart.values():
        closed = close_surface(series)
        for vertices in closed.vertices_mm:
            caps = caps_of(vertices, closed.triangles, closed.caps)
            assert len(caps) == OPENINGS[series.name]
            assert max(cap.beyond_mm for cap in caps) < 0.6 * MAX_BEYOND_MM
            assert max(cap.share for cap in caps) < 0.6 * MAX_CAP_SHARE


def test_left_ventricle_contracts_as_published(heart):
    """158 to 57 ml; the planar caps at the valves add some 10 %."""
    millilitres = close_surface(heart["LV_ENDOCARDIAL"]).volumes_mm3() / 1000
    assert 150 < millilitres[0] < 180
    assert 50 < millilitres[1] < 75


def test_model_lies_on_the_surface(heart):
    model = model_from_surfaces(heart["EPICARDIAL"], options=ModelOptions())
    result = check_model(model, points_per_phase=2000, rng=np.random.default_rng(3))
    assert model.ed_phase == 0
    assert model.es_fraction == model.timing.fractions[1]
    assert result.mean_mm < 0.02
    assert result.p99_mm < 0.15
    assert result.normal_median_deg < 1.5
    assert result.normal_p95_deg < 5.0
    assert border_distance_mm(model) >= 14.999
    assert 0.05 < result.excluded_area_share < 0.3


def test_label_maps_hold_the_enclosed_volumes(heart):
    outer = heart["EPICARDIAL"].vertices_mm
    lower, upper = outer.min(axis=(0, 1)) - 5, outer.max(axis=(0, 1)) + 5
    nx, ny, nz = np.ceil((upper - lower) / 2.0).astype(int).tolist()
    labels = rasterise(heart, Grid.axis_aligned("mr", (nx, ny, nz), lower, 2.0))
    for phase in range(len(PHASES)):
        heart_mm3 = close_surface(heart["EPICARDIAL"]).volumes_mm3()[phase]
        blood_mm3 = sum(
            close_surface(heart[name]).volumes_mm3()[phase] for name in ("LV_ENDOCARDIAL", "RV_ENDOCARDIAL")
        )
        assert np.count_nonzero(labels.values[phase]) * 8.0 == pytest.approx(heart_mm3, rel=0.02)
        assert np.count_nonzero(labels.values[phase] == 2) * 8.0 == pytest.approx(blood_mm3, rel=0.02)
