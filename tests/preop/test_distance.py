"""Signed distance on a grid: closed form on a sphere, and Open3D on a bumpy ball."""

import numpy as np
import pytest

from dvf_ig.core import Grid, InvalidInputError, Mesh
from dvf_ig.preop import signed_distance_mm


def test_sphere(sphere_of):
    vertices, triangles = sphere_of(20.0, 4)
    grid = Grid.axis_aligned("mr", (41, 41, 41), [-30.0] * 3, 1.5)
    band_mm = 6.0
    got = signed_distance_mm(Mesh("mr", vertices, triangles), grid, band_mm)
    expected = 20.0 - np.linalg.norm(grid.centers_mm(), axis=-1)
    corners = vertices[triangles]
    edge_mm = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    sagitta_mm = edge_mm**2 / (5 * 20.0)
    exact = np.abs(expected) < band_mm - 0.5
    np.testing.assert_allclose(got[exact], expected[exact], atol=sagitta_mm)
    outside = expected < 0
    np.testing.assert_allclose(got[outside], expected[outside], atol=sagitta_mm + 0.25)


def test_open3d_agrees_within_the_band(sphere_of):
    o3d = pytest.importorskip("open3d")
    vertices, triangles = sphere_of(1.0, 3)
    bumps = 20 + 3 * np.sin(4 * vertices[:, :1]) * np.cos(5 * vertices[:, 1:2])
    mesh = Mesh("mr", vertices * bumps, triangles)
    grid = Grid.axis_aligned("mr", (41, 41, 41), [-29.7, -30.1, -30.3], 1.5)
    got = signed_distance_mm(mesh, grid, 6.0)
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(mesh.vertices_mm.astype(np.float32), mesh.triangles.astype(np.uint32))
    near = np.nonzero(np.abs(got) < 5.5)
    chosen = tuple(index[::7] for index in near)
    points = grid.centers_mm()[chosen].astype(np.float32)
    expected = -scene.compute_signed_distance(points, nsamples=3).numpy()
    np.testing.assert_allclose(got[chosen], expected, atol=2e-4)


def test_grids_that_cannot_be_doubled_are_refused(sphere_of):
    mesh = Mesh("mr", *sphere_of(20.0, 1))
    with pytest.raises(InvalidInputError, match="multiples of 4"):
        signed_distance_mm(mesh, Grid.axis_aligned("mr", (40, 41, 41), [-30.0] * 3, 1.5), 6.0)
