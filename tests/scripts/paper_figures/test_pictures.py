"""Slices, scenes and tracking errors: what must be in the pictures, read from what was drawn."""

from typing import Any

import numpy as np
import pytest

from scripts.paper_figures import (
    HeartView,
    Section,
    Slice,
    dilation_distance_mm,
    held_figure,
    scene_figure,
    slice_figure,
    tracking_errors_figure,
)


def test_dilation_counts_faces_and_is_zero_between_voxels() -> None:
    inside = np.zeros((11, 11, 11), dtype=bool)
    inside[3:8, 3:8, 3:8] = True
    distance = dilation_distance_mm(inside, 2.0)
    assert distance[5, 5, 2:9].tolist() == [-1.0, 1.0, 3.0, 5.0, 3.0, 1.0, -1.0]
    assert distance[2, 2, 5] == -3.0, "two steps over the edge, 2.8 mm by Euclid less half a voxel"


def test_a_slice_has_its_contour_and_arrows() -> None:
    contour = np.array([[[0.0, 0.0], [1.0, 1.0]]])
    shown = Slice(np.eye(4), (0.0, 2.0, 2.0, 0.0), contour)
    figure: Any = slice_figure(shown, "t", "f", force=(np.zeros((1, 2)), np.array([[0.3, 0.0]])))
    axis = figure.axes[0]
    assert len(axis.collections) == 2
    assert tuple(axis.images[0].get_extent()) == (0.0, 2.0, 2.0, 0.0)
    assert len(figure.axes) == 2, "a grey scale"


def test_a_scene_draws_the_side_that_faces_the_eye() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    view = HeartView(vertices, triangles, np.array([1.0, 0, 0]), np.ones((3, 3)), np.ones((2, 3)))
    figure: Any = scene_figure(view, "t")
    (axis,) = figure.axes
    heart, pellets, tip = axis.collections
    assert len(heart.get_facecolors()) == 3, "all but the one that faces away"
    assert len(pellets._offsets3d[0]) == 3
    assert len(tip._offsets3d[0]) == 1


def test_a_section_shows_surface_and_tip_at_each_time() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    view = HeartView(vertices, np.array([[0, 2, 1]]), np.array([1.0, 0, 0]), np.empty((0, 3)), np.eye(3)[:2])
    sections = [
        Section(name, np.zeros((2, 2, 2)), np.array([0.0, y])) for name, y in (("a", 0.0), ("b", 3.0))
    ]
    axis: Any = held_figure(view, sections, "t").axes[1]
    assert [line.get_ydata()[0] for line in axis.lines] == [0.0, 3.0]
    assert len(axis.collections) == 2


def test_tracking_errors_state_both_means() -> None:
    t_s = np.arange(100) / 10
    figure: Any = tracking_errors_figure(t_s, 0.2 * np.sin(t_s), "t", 0.29)
    left, right = figure.axes
    assert sum(bar.get_height() for bar in left.patches) == pytest.approx(100.0)
    assert [text.get_text() for text in left.get_legend().get_texts()] == [
        f"mean here {np.abs(0.2 * np.sin(t_s)).mean():.2f} mm",
        "mean in Ren 2008 0.29 mm",
    ]
    np.testing.assert_array_equal(right.lines[0].get_ydata(), 0.2 * np.sin(t_s))
