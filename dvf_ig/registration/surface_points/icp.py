"""Robust point-to-surface ICP of touched points to the model's mesh of one phase, with Open3D.

Point-to-plane distances to the nearest triangle's centre under Tukey's biweight, whose reach shrinks (Chen
and Medioni 1992; Beaton and Tukey 1974). It sees one phase of the heart; the distance of the model, phase by
phase, finishes.
"""

import importlib
from typing import Any

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, MissingDependencyError, Rigid, nearest_phase
from dvf_ig.registration.pose_chart import PoseChart

from .touched import TouchedPoints

REACH_MM = (25.0, 10.0)
"""Tukey's constant in turn: beyond it a point has no weight."""
STEPS = 25
"""Most steps with each constant."""
DIGITS = 2
"""A pose is rounded to this part of a millimetre: the order in which Open3D's threads sum must not show."""


class SurfaceIcp:
    """Mesh and points as Open3D wants them, for many starts.

    Args:
        touched: points.
        model: fixture model; its surface at the phase that most points were touched nearest to is used,
            without the triangles that close an opening.
        center_mm: (3,) about which poses turn, the model's frame.
    Raises:
        MissingDependencyError: Open3D or a library that it loads is absent.
    """

    def __init__(self, touched: TouchedPoints, model: DvfModel, center_mm: FloatArray) -> None:
        self._open3d = _open3d()
        nearest = nearest_phase(model.timing.fractions, touched.model_phase)
        self.phase = int(np.bincount(nearest).argmax())
        self.surface_mm, normals = _triangle_centres(model, self.phase)
        self._center_mm = np.asarray(center_mm, dtype=np.float64)
        self._source = self._cloud(touched.points.xyz_mm)
        self._target = self._cloud(self.surface_mm)
        self._target.normals = self._open3d.utility.Vector3dVector(normals)

    def fit(self, start: Rigid) -> Rigid:
        """The pose near `start` at which the points lie on the mesh."""
        registration = self._open3d.pipelines.registration
        matrix = start.matrix
        for reach in REACH_MM:
            result = registration.registration_icp(
                self._source,
                self._target,
                2 * reach,
                matrix,
                registration.TransformationEstimationPointToPlane(registration.TukeyLoss(k=reach)),
                registration.ICPConvergenceCriteria(max_iteration=STEPS),
            )
            matrix = np.array(result.transformation)
        if not np.isfinite(matrix).all():
            return start
        chart = PoseChart(start, self._center_mm)
        found = chart.coordinates(Rigid.from_matrix(matrix, start.target, start.source))
        return chart.pose(np.round(found, DIGITS))

    def _cloud(self, xyz_mm: FloatArray) -> Any:
        return self._open3d.geometry.PointCloud(self._open3d.utility.Vector3dVector(np.array(xyz_mm)))


def _triangle_centres(model: DvfModel, phase: int) -> tuple[FloatArray, FloatArray]:
    """(m, 3) centres and (m, 3) unit outward normals of the measured triangles of one phase."""
    mesh = model.reference[phase]
    corners = mesh.vertices_mm[mesh.triangles[~model.reference_caps[phase]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    solid = area > 0
    return corners[solid].mean(axis=1), normals[solid] / area[solid, None]


def _open3d() -> Any:
    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as exc:
        raise MissingDependencyError(
            f"fitting touched surface points needs Open3D ({exc}); install it with: "
            'pip install "dvf-ig[open3d]" (`dvf-ig doctor` names system libraries that it lacks)'
        ) from exc
