"""Points touched on a beating surface whose pose is known, and a small heart with a shape of its own."""

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation
from toy_sphere import sphere

from dvf_ig.core import CycleTiming, DvfModel, FloatArray, Points, Rigid, SurfaceSeries, TouchedPoints
from dvf_ig.preop import ModelOptions, model_from_surfaces

ANTERIOR = np.array([0.0, -1.0, 0.0])


@lru_cache(maxsize=2)
def beating_model(bumps: float = 1.0) -> DvfModel:
    """Two ventricles and a groove between them, some 80 mm wide; a beating ball with 0 bumps."""
    unit, triangles = sphere(1.0, subdivisions=3)
    x, y, z = unit.T
    shape = 1 + bumps * (
        0.16 * np.exp(-4 * ((x - 0.7) ** 2 + (y + 0.6) ** 2 + z**2))
        - 0.14 * np.exp(-9 * ((x - 0.1) ** 2 + (y + 0.9) ** 2 + (z - 0.2) ** 2))
        + 0.22 * np.exp(-5 * (x**2 + y**2 + (z + 1) ** 2))
    )
    axes = 40.0 * (1 + bumps * np.array([0.05, -0.15, 0.12]))
    still = unit * shape[:, None] * axes
    stack = np.stack([still, 0.92 * still, 0.96 * still + [1.0, 0.5, 2.0]])
    timing = CycleTiming(np.array([0.0, 0.35, 0.7]), 0.85)
    series = SurfaceSeries("EPICARDIAL", "mr", stack, triangles, timing, "toy")
    return model_from_surfaces(series, options=ModelOptions(knot_spacing_mm=6.0))


def heart_center_mm(model: DvfModel) -> FloatArray:
    """Centre of the box of the end-diastolic surface."""
    vertices = model.reference[model.ed_phase].vertices_mm
    return np.asarray(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))


def touched_points(
    model: DvfModel,
    mr_from_tracker: Rigid,
    rng: np.random.Generator,
    *,
    count: int = 40,
    noise_mm: float = 1.0,
    outlier_share: float = 0.1,
    facing: float = 0.0,
) -> TouchedPoints:
    """Points on the anterior surface at random phases, with noise, and outliers 10 mm off in any direction.

    Args:
        facing: least component of the outward normal to the front.
    """
    nearest = rng.integers(model.phases, size=count)
    xyz = np.empty((count, 3))
    for i, phase in enumerate(nearest):
        mesh, caps = model.reference[phase], model.reference_caps[phase]
        corners = mesh.vertices_mm[mesh.triangles[~caps]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normal, axis=1)
        seen = (normal @ ANTERIOR) / area > facing
        chosen = rng.choice(len(corners), p=area * seen / (area * seen).sum())
        xyz[i] = rng.dirichlet([1, 1, 1]) @ corners[chosen]
    xyz += rng.normal(0, noise_mm, (count, 3))
    off = rng.permutation(count)[: round(outlier_share * count)]
    ways = rng.normal(size=(len(off), 3))
    xyz[off] += 10.0 * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    points = mr_from_tracker.inverse().apply(Points("mr", xyz))
    return TouchedPoints(points, model.timing.fractions[nearest], sigma_mm=noise_mm)


def pose_off(pose: Rigid, rng: np.random.Generator, center_mm: FloatArray, mm: float, deg: float) -> Rigid:
    """The pose turned and shifted by so much in random directions."""
    turn, shift = rng.normal(size=(2, 3))
    return pose.perturbed_left(
        np.radians(deg) * turn / np.linalg.norm(turn), mm * shift / np.linalg.norm(shift), center_mm
    )


def random_pose(rng: np.random.Generator) -> Rigid:
    """Any orientation of the patient in the tracker's space."""
    turn = Rotation.random(random_state=rng).as_matrix()
    return Rigid("mr", "tracker", turn, rng.normal(0, 100, 3))


def grid_targets(model: DvfModel) -> Points:
    """27 points in the box of the end-diastolic surface."""
    vertices = model.reference[model.ed_phase].vertices_mm
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    steps = np.stack(np.meshgrid(*[[0.1, 0.5, 0.9]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return Points("mr", low + steps * (high - low))
