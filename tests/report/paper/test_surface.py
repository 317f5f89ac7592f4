"""Fig. 4: the level set that is drawn lies within the model's stated error of the mesh."""

import numpy as np
import pytest

from dvf_ig.core import DvfModel
from dvf_ig.preop import check_model
from dvf_ig.report.paper import SurfaceFit, surface_figure, surface_fit


@pytest.fixture(scope="module")
def fit(sphere_model: DvfModel) -> SurfaceFit:
    return surface_fit(sphere_model, phase=0, rng=np.random.default_rng(0), points_per_phase=500)


def test_the_drawn_level_set_is_the_mesh_within_the_stated_error(
    fit: SurfaceFit, sphere_model: DvfModel
) -> None:
    contour = surface_figure(fit).axes[0].collections[1]
    drawn = np.concatenate([path.vertices for path in contour.get_paths()])
    stated = check_model(sphere_model, points_per_phase=500, rng=np.random.default_rng(1))
    # the mesh is a sphere of 20 mm within 0.03 mm; the contour is linear between samples of 0.25 mm
    chord_mm = 0.25**2 / (8 * 20.0) + 0.03
    miss = np.abs(np.linalg.norm(drawn, axis=1) - 20.0)
    assert len(drawn) > 300
    assert miss.max() < stated.max_mm + chord_mm
    assert miss.mean() < stated.mean_mm + chord_mm


def test_errors_are_those_of_all_phases(fit: SurfaceFit, sphere_model: DvfModel) -> None:
    stated = check_model(sphere_model, points_per_phase=500, rng=np.random.default_rng(1))
    assert len(fit.errors_mm) == 3 * 500
    assert fit.errors_mm.mean() == pytest.approx(stated.mean_mm, rel=0.15)
    # corners stand out of their facets by up to 0.03 mm
    assert fit.mesh_error_mm.max() < stated.max_mm + 0.03
    shares = [patch.get_height() for patch in surface_figure(fit).axes[2].patches]  # type: ignore[attr-defined]
    assert sum(shares[:50]) == pytest.approx(100.0)


def test_the_mesh_is_that_of_the_slice(fit: SurfaceFit) -> None:
    assert np.linalg.norm(fit.mesh_mm, axis=-1) == pytest.approx(20.0, abs=0.05)
