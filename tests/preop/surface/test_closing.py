"""Welding, capping, orienting; and the surfaces that are refused."""

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, InvalidInputError, SurfaceSeries
from dvf_ig.preop import caps_of, close_surface
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


def heart_of(sphere_of):
    """A closed ellipsoid of the size of a heart: 80 x 72 x 96 mm."""
    vertices, triangles = sphere_of(1.0, 4)
    return vertices * np.array([40.0, 36.0, 48.0]), triangles


def without(vertices, triangles, share, axis):
    """The triangles below the height along an axis above which `share` of it lies."""
    along = vertices[triangles].mean(axis=1)[:, axis]
    return triangles[along < along.max() - share * np.ptp(along)]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("share", [0.5, 0.33, 0.25])
def test_a_heart_of_which_a_large_part_is_missing_is_refused(sphere_of, share, axis):
    vertices, triangles = heart_of(sphere_of)
    opened = without(vertices, triangles, share, axis)
    with pytest.raises(
        InvalidInputError, match=r"a part of an organ.*1 cap, not measured, of \d+% of the measured"
    ):
        close_surface(series_of(vertices, opened))
    with pytest.raises(InvalidInputError, match=r"mm2 and its middle at .* needed at most 30% and 12 mm"):
        close_surface(series_of(vertices, opened))


def test_half_a_heart_that_is_missing_in_one_phase_alone_is_refused(sphere_of):
    """The opening is small in the first phase and wide in the second."""
    vertices, triangles = heart_of(sphere_of)
    opened = without(vertices, triangles, 0.1, 2)
    rim = vertices[:, 2] > 30.0
    wide = np.where(rim[:, None], vertices * np.array([1.6, 1.6, 1.0]), vertices)
    timing = CycleTiming.uniform(2, 0.8)
    close_surface(SurfaceSeries("EPICARDIAL", "mr", np.stack([vertices] * 2), opened, timing, "x"))
    with pytest.raises(InvalidInputError, match="closing it in phase 1 takes 1 cap"):
        close_surface(SurfaceSeries("EPICARDIAL", "mr", np.stack([vertices, wide]), opened, timing, "x"))


def test_a_cap_that_a_file_marks_is_bounded_as_well(sphere_of):
    vertices, triangles = heart_of(sphere_of)
    caps = vertices[triangles].mean(axis=1)[:, 2] > 0.0
    stack = np.stack([vertices] * 2)
    marked = SurfaceSeries("EPICARDIAL", "mr", stack, triangles, TIMING, "x", caps)
    with pytest.raises(InvalidInputError, match="a part of an organ"):
        close_surface(marked)


def test_openings_are_judged_shell_by_shell(sphere_of):
    """Half a small ball beside a large whole one has little of the area of both."""
    vertices, triangles = sphere_of(60.0, 3)
    small, half = sphere_of(10.0, 3)
    half = without(small, half, 0.5, 2)
    both = np.vstack([vertices, small + np.array([100.0, 0, 0])])
    with pytest.raises(InvalidInputError, match=r"of 5\d% of the measured area"):
        close_surface(series_of(both, np.vstack([triangles, half + len(vertices)])))


def open_ball(radius, height, rings=60, sectors=90):
    """A ball without what lies above `height`, in rings: its rim is a circle."""
    polar = np.linspace(np.arccos(height / radius), np.pi, rings + 1)[:-1]
    turn = np.arange(sectors) * 2 * np.pi / sectors
    theta, phi = (a.ravel() for a in np.meshgrid(polar, turn, indexing="ij"))
    unit = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    index = np.arange(rings * sectors).reshape(rings, sectors)
    a, b = index, np.roll(index, -1, axis=1)
    parts = [[a[:-1], a[1:], b[:-1]], [b[:-1], a[1:], b[1:]], [a[-1], np.full(sectors, len(unit)), b[-1]]]
    triangles = np.vstack([np.stack([corner.ravel() for corner in part], axis=1) for part in parts])
    return radius * np.vstack([unit, [[0.0, 0.0, -1.0]]]), triangles


def test_depth_beyond_a_cap_is_that_of_a_ball():
    closed = close_surface(series_of(*open_ball(40.0, 32.0)))
    (cap,) = caps_of(closed.vertices_mm[0], closed.triangles, closed.caps)
    assert cap.beyond_mm == pytest.approx(40.0 - 32.0, rel=0.005)
    assert cap.share == pytest.approx((40.0 - 32.0) / 80.0, rel=0.005)
    assert cap.area_mm2 == pytest.approx(np.pi * (40.0**2 - 32.0**2), rel=0.005)
    np.testing.assert_allclose(cap.middle_mm, [0.0, 0.0, 32.0], atol=1e-9)


@pytest.mark.parametrize(("height", "refused"), [(28.3, False), (27.7, True)])
def test_more_than_twelve_millimetres_beyond_a_cap_are_refused(height, refused):
    series = series_of(*open_ball(40.0, height))
    if refused:
        with pytest.raises(
            InvalidInputError, match="up to 12 mm of the organ may lie beyond; needed at most"
        ):
            close_surface(series)
    else:
        assert close_surface(series).caps.any()


def test_caps_are_listed_largest_first(sphere_of):
    vertices, triangles = sphere_of(40.0, 4)
    along = vertices[triangles].mean(axis=1)[:, 2]
    closed = close_surface(series_of(vertices, triangles[(along < 36.0) & (along > -38.5)]))
    large, small = caps_of(closed.vertices_mm[0], closed.triangles, closed.caps)
    assert large.area_mm2 > small.area_mm2 > 0
    assert large.middle_mm[2] > 30 > -30 > small.middle_mm[2]
    assert large.share == small.share


@pytest.mark.parametrize("squeeze", [0.0, 1e-7])
def test_a_surface_without_volume_is_refused(sphere_of, squeeze):
    vertices, triangles = sphere_of(20.0, 2)
    stack = np.stack([vertices, vertices * np.array([1.0, squeeze, 1.0])])
    with pytest.raises(InvalidInputError, match="encloses no volume in phase 1"):
        close_surface(SurfaceSeries("EPICARDIAL", "mr", stack, triangles, TIMING, "x"))
    with pytest.raises(InvalidInputError, match="has no area"):
        close_surface(series_of(0.0 * vertices, triangles))
