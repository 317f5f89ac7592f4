"""Welding, capping, orienting; and the surfaces that are refused."""

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, InvalidInputError, SurfaceSeries
from dvf_ig.preop import close_surface
from dvf_ig.preop.surface.topology import count_edges

TIMING = CycleTiming.uniform(2, 0.8)


def series_of(vertices, triangles):
    stack = np.stack([vertices, 0.9 * vertices])
    return SurfaceSeries("EPICARDIAL", "mr", stack, triangles, TIMING, "ball")


def without_cap(vertices, triangles, height):
    """The triangles whose centroid lies below `height` along z."""
    return triangles[vertices[triangles].mean(axis=1)[:, 2] < height]


def test_a_closed_surface_comes_back_as_it_was(sphere_of):
    vertices, triangles = sphere_of(20.0, 2)
    closed = close_surface(series_of(vertices, triangles))
    assert np.array_equal(closed.triangles, triangles)
    assert np.array_equal(closed.vertices_mm[0], vertices)
    assert not closed.caps.any()


def test_closing_twice_changes_nothing(sphere_of):
    vertices, triangles = sphere_of(20.0, 3)
    once = close_surface(series_of(vertices, without_cap(vertices, triangles, 15.0)))
    twice = close_surface(once)
    assert np.array_equal(once.triangles, twice.triangles)
    assert np.array_equal(once.vertices_mm, twice.vertices_mm)
    assert np.array_equal(once.caps, twice.caps)


def test_an_opening_is_capped_and_the_cap_flagged(sphere_of):
    vertices, triangles = sphere_of(20.0, 4)
    opened = without_cap(vertices, triangles, 14.0)
    closed = close_surface(series_of(vertices, opened))
    assert count_edges(closed.triangles).closed
    assert np.array_equal(closed.triangles[~closed.caps].shape, opened.shape)
    assert closed.caps.any()
    h = 20.0 - 14.0
    missing_mm3 = np.pi * h**2 * (3 * 20.0 - h) / 3
    full_mm3 = 4 / 3 * np.pi * 20.0**3
    assert closed.volumes_mm3()[0] == pytest.approx(full_mm3 - missing_mm3, rel=0.02)


def test_split_seams_are_welded(sphere_of):
    vertices, triangles = sphere_of(20.0, 2)
    north = vertices[triangles].mean(axis=1)[:, 2] > 0
    split = np.where(north[:, None], triangles, triangles + len(vertices))
    closed = close_surface(series_of(np.vstack([vertices, vertices + 5e-7]), split))
    assert closed.vertices_mm.shape[1] == len(vertices)
    assert not closed.caps.any()


def test_vertices_that_meet_in_one_phase_only_stay_apart(sphere_of):
    vertices, triangles = sphere_of(20.0, 2)
    both = np.vstack([triangles, triangles + len(vertices)])
    touching = np.stack(
        [np.vstack([vertices, vertices]), np.vstack([vertices, vertices + np.array([60.0, 0, 0])])]
    )
    closed = close_surface(SurfaceSeries("EPICARDIAL", "mr", touching, both, TIMING, "two balls"))
    assert closed.vertices_mm.shape[1] == 2 * len(vertices)


def test_inconsistent_and_inward_triangles_are_flipped(sphere_of):
    vertices, triangles = sphere_of(20.0, 2)
    mixed = triangles.copy()
    mixed[::3] = mixed[::3][:, ::-1]
    closed = close_surface(series_of(vertices, mixed))
    expected = series_of(vertices, triangles).volumes_mm3()
    np.testing.assert_allclose(closed.volumes_mm3(), expected)
    inward = close_surface(series_of(vertices, triangles[:, ::-1]))
    np.testing.assert_allclose(inward.volumes_mm3(), expected)


def test_an_extra_sheet_is_refused_with_counts(sphere_of):
    vertices, triangles = sphere_of(20.0, 1)
    extra = np.vstack([vertices, [[0.0, 0.0, 0.0]]])
    fin = [[*triangles[0][:2], len(vertices)]]
    with pytest.raises(InvalidInputError, match=r"EPICARDIAL is not closed.*1 edges with more than two"):
        close_surface(series_of(extra, np.vstack([triangles, fin])))


def test_touching_openings_are_refused(sphere_of):
    vertices, triangles = sphere_of(20.0, 2)
    at_vertex = np.flatnonzero((triangles == triangles[0, 0]).any(axis=1))
    two_apart = [at_vertex[0]]
    two_apart += [t for t in at_vertex if len(set(triangles[t]) & set(triangles[two_apart[0]])) == 1][:1]
    with pytest.raises(InvalidInputError, match="openings that touch"):
        close_surface(series_of(vertices, np.delete(triangles, two_apart, axis=0)))


def test_a_one_sided_surface_is_refused():
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rail = []
    for sign in (-1, 1):
        radius = 20 + sign * 5 * np.cos(turn / 2)
        rail.append(
            np.stack([radius * np.cos(turn), radius * np.sin(turn), sign * 5 * np.sin(turn / 2)], axis=1)
        )
    n = len(turn)
    triangles = []
    for i in range(n):
        j = (i + 1) % n
        a, b, c, d = (i, n + i, j, n + j) if j else (i, n + i, n, 0)
        triangles += [[a, c, b], [b, c, d]]
    with pytest.raises(InvalidInputError, match="one-sided"):
        close_surface(series_of(np.vstack(rail), np.array(triangles)))


def test_a_sheet_is_refused():
    grid = np.array([[x, y, 0.0] for x in range(5) for y in range(5)])
    triangles = []
    for x in range(4):
        for y in range(4):
            k = 5 * x + y
            triangles += [[k, k + 5, k + 1], [k + 1, k + 5, k + 6]]
    with pytest.raises(InvalidInputError, match="open sheet"):
        close_surface(series_of(grid, np.array(triangles)))
