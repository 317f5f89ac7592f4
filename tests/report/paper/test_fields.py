"""Figs 5 and 11: arrows point out of a forbidden region, and back to the surface from either side."""

from typing import Any

import numpy as np
import pytest

from dvf_ig.core import DvfModel
from dvf_ig.guidance import Evaluator, Gaussian, Sigmoid
from dvf_ig.report.paper import field_figure, organ_field, surface_field
from dvf_ig.report.paper.fields import SliceField


def radial(field: SliceField) -> tuple[np.ndarray, np.ndarray]:
    """Force along the outward radius of the sphere, and how far outside it, at every arrow in the plane."""
    r = np.linalg.norm(field.arrow_xy_mm, axis=0)
    outward = field.arrow_xy_mm / np.maximum(r, 1e-9)
    return np.einsum("kij,ijk->ij", outward, field.arrow_n[..., :2]), r - 20.0


@pytest.mark.parametrize("view", [organ_field, surface_field])
def test_a_forbidden_region_pushes_outward(view, sphere_model: DvfModel) -> None:
    push, outside = radial(view(Evaluator(sphere_model, Sigmoid(1.0)), 0.0))
    near = np.abs(outside) < 8.0
    assert (push[near] > 0.0).all()
    assert push[near & (outside < -5.0)] == pytest.approx(0.6, abs=0.01)
    assert (push[near & (outside > 5.0)] < 0.01).all()
    surface = near & (np.abs(outside) < 0.5)
    assert push[surface] == pytest.approx(0.3, abs=0.08)


@pytest.mark.parametrize("view", [organ_field, surface_field])
def test_guidance_pulls_back_from_either_side(view, sphere_model: DvfModel) -> None:
    push, outside = radial(view(Evaluator(sphere_model, Gaussian(3.0, 1.0)), 0.0))
    near = np.abs(outside) < 8.0
    assert (push[near & (outside < -0.5)] > 0.0).all()
    assert (push[near & (outside > 0.5)] < 0.0).all()
    assert np.abs(push[near & (np.abs(outside) < 0.3)]).max() < 0.02


def test_what_is_drawn_is_the_field(sphere_model: DvfModel) -> None:
    evaluator = Evaluator(sphere_model, Sigmoid(1.0))
    whole, near = organ_field(evaluator, 0.0), surface_field(evaluator, 0.0)
    assert near.center_mm == pytest.approx([20.0, 0.0, 0.0], abs=0.1)
    figure = field_figure(whole, near, "forces")
    left = figure.axes[0]
    np.testing.assert_array_equal(left.images[0].get_array(), whole.force_size_n)
    # rows run to the back, and the axis with them: the front is at the top
    assert tuple(left.images[0].get_extent()[2:]) == left.get_ylim()
    assert left.get_ylim()[0] > left.get_ylim()[1]
    arrows: Any = left.collections[-1]
    shown = np.linalg.norm(whole.arrow_n, axis=2) > 0.02 * 0.6
    np.testing.assert_allclose(arrows.U, whole.arrow_n[shown][:, 0])
    np.testing.assert_allclose(arrows.V, whole.arrow_n[shown][:, 1])
    outline = np.concatenate([path.vertices for path in left.collections[0].get_paths()])
    assert np.linalg.norm(outline, axis=1) == pytest.approx(20.0, abs=0.1)
