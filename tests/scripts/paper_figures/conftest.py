"""A model of a beating sphere, with the surfaces it was fitted to."""

import pytest

from dvf_ig.core import DvfModel, SurfaceSeries
from dvf_ig.preop import ModelOptions, model_from_surfaces


@pytest.fixture(scope="session")
def sphere_model(beating_sphere: SurfaceSeries) -> DvfModel:
    """Radius 20, 17 and 18.5 mm about the origin at 0, 0.3 and 0.7 of the cycle."""
    return model_from_surfaces(beating_sphere, options=ModelOptions(knot_spacing_mm=4.0, margin_mm=14.0))
