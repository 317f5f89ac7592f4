"""The figure of a propagated surface: its contour on each plane is the surface of that phase."""

from pathlib import Path

import numpy as np

from dvf_ig.core import Grid, SurfaceSeries, VolumeSeries
from dvf_ig.preop.motion.quality import MotionQuality
from dvf_ig.report.motion import motion_figure, write_motion_picture

PITCH_MM = 2.0


def image(series: SurfaceSeries) -> VolumeSeries:
    grid = Grid.axis_aligned("mr", (31, 31, 31), np.full(3, -30.0), PITCH_MM)
    return VolumeSeries(grid, np.zeros((3, 31, 31, 31), np.float32), series.timing)


def quality() -> MotionQuality:
    n = np.ones(3)
    return MotionQuality(n, n, n, n, 0 * n, None, None, n, n, 1, 0.1, 0.2, None)


def test_contours_are_the_surface_of_each_phase(beating_sphere: SurfaceSeries, tmp_path: Path) -> None:
    figure = motion_figure(image(beating_sphere), beating_sphere, quality(), 0, 1)
    # the origin lies 30 mm from the first voxel; the plane misses it by a thousandth of a voxel
    for row, radius_mm in ((0, 20.0), (3, 17.0)):
        for axis in figure.axes[row : row + 3]:
            dotted, contour = (
                np.concatenate([path.vertices for path in lines.get_paths()]) for lines in axis.collections
            )
            assert np.allclose(np.linalg.norm(dotted - 30.0, axis=-1), 20.0, atol=0.1)
            assert np.allclose(np.linalg.norm(contour - 30.0, axis=-1), radius_mm, atol=0.1)
    path = tmp_path / "motion.png"
    write_motion_picture(path, image(beating_sphere), beating_sphere, quality(), ed_phase=0, es_phase=1)
    assert path.read_bytes().startswith(b"\x89PNG")
