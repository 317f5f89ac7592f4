"""Signed distance on a grid: closed form on a sphere, and Open3D on a bumpy ball."""

import numpy as np
import pytest

from dvf_ig.core import Grid, InvalidInputError, Mesh
from dvf_ig.preop import build_triangle_tree, signed_distance_mm
from dvf_ig.preop.check import angle_deg, facet_normals, smooth_normals, vertex_normals
from dvf_ig.preop.distance.signed import inside_mask
from dvf_ig.preop.surface.from_labels import surface_of_mask


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


@pytest.mark.parametrize("shape", [(41, 41, 41), (40, 38, 43), (6, 40, 5)])
def test_the_sign_is_that_of_the_winding_number_at_every_sample(sphere_of, shape):
    """A spike of 1.5 mm between samples 1.5 mm apart: what interpolation would miss is computed."""
    vertices, triangles = sphere_of(1.0, 3)
    radius = 14.0 + 12.0 * np.exp(-(((vertices - [0.6, 0.64, 0.48]) / 0.06) ** 2).sum(axis=1))
    mesh = Mesh("mr", vertices * radius[:, None], triangles)
    grid = Grid.axis_aligned("mr", shape, [-29.7, -30.1, -30.3], 1.5)
    got = signed_distance_mm(mesh, grid, 3.0)
    assert got.shape == shape
    inside = inside_mask(grid.to_index(mesh.vertices_mm), mesh.triangles, grid.shape)
    np.testing.assert_array_equal(got > 0.0, inside)


def test_a_rotated_grid_is_refused(sphere_of):
    turned = Grid("mr", (41, 41, 41), [-30.0] * 3, [1.5] * 3, np.eye(3)[[1, 2, 0]])
    with pytest.raises(InvalidInputError, match="rotated"):
        signed_distance_mm(Mesh("mr", *sphere_of(20.0, 1)), turned, 6.0)


def test_nearest_points_and_smooth_normals_of_a_sphere(sphere_of):
    mesh = Mesh("mr", *sphere_of(20.0, 4))
    rng = np.random.default_rng(2)
    outward = rng.normal(size=(500, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    points = outward * rng.uniform(15.0, 25.0, size=(500, 1))
    tree = build_triangle_tree(mesh.vertices_mm, mesh.triangles)
    nearest = tree.nearest(points)
    assert (nearest.weights >= 0.0).all()
    np.testing.assert_allclose(nearest.weights.sum(axis=1), 1.0)
    apart = np.linalg.norm(points - nearest.points_mm, axis=1)
    np.testing.assert_allclose(apart, nearest.distance_mm, atol=1e-12)
    again = np.einsum("nk,nkx->nx", nearest.weights, mesh.vertices_mm[mesh.triangles[nearest.triangle]])
    np.testing.assert_allclose(again, nearest.points_mm, atol=1e-12)
    of_facets = angle_deg(facet_normals(mesh)[nearest.triangle], nearest.points_mm)
    of_smooth = angle_deg(smooth_normals(mesh, vertex_normals(mesh), nearest), nearest.points_mm)
    assert of_smooth.max() < 0.2 < np.median(of_facets)


def test_a_mask_gives_its_surface_without_shrinking():
    grid = Grid.axis_aligned("mr", (41, 41, 41), [-20.0] * 3, 1.0)
    mesh = surface_of_mask(np.linalg.norm(grid.centers_mm(), axis=-1) < 14.0, grid)
    radius = np.linalg.norm(mesh.vertices_mm, axis=1)
    assert abs(radius.mean() - 14.0) < 0.05
    with pytest.raises(InvalidInputError, match="no voxel inside"):
        surface_of_mask(np.zeros(grid.shape, dtype=bool), grid)
