"""A beating, drifting ball whose distance field is known in closed form."""

import numpy as np
from toy_sphere import sphere

from dvf_ig.core import CycleTiming, DvfModel, Mesh
from dvf_ig.preop import AxisSolver, fit_coefficients

KNOT = 2.0
CELLS = (30, 30, 30)
ORIGIN = np.array([-30.0, -29.0, -31.0])
FRACTIONS = np.array([0.05, 0.3, 0.55, 0.8])
RADII = np.array([16.0, 13.0, 14.0, 15.5])
CENTERS = np.array([[0.0, 0, 0], [2.0, 1, 0], [1.0, -1, 2], [0.5, 0, 1]])


def ball_model() -> DvfModel:
    """Phases 0 to 3 at FRACTIONS, radius RADII, centre CENTERS; fitted to 0.01 mm outside the core."""
    coefficients = _fitted(ORIGIN, CELLS, RADII, CENTERS)
    triangle = Mesh("mr", np.array([[-31.0, 0, 0], [31, 0, 0], [0, 31, 0]]), np.array([[0, 1, 2]]))
    return DvfModel(
        patient_id="ball",
        surface_name="EPICARDIAL",
        frame="mr",
        timing=CycleTiming(FRACTIONS, 0.8),
        es_fraction=0.3,
        ed_phase=0,
        coefficients=coefficients,
        origin_mm=ORIGIN,
        knot_spacing_mm=KNOT,
        reference=(triangle,) * 4,
        reference_caps=(np.zeros(1, dtype=bool),) * 4,
    )


def structure(name, center, radius, *, still=False, margin_mm=10.0) -> DvfModel:
    """A smaller ball that beats and drifts as `ball_model`, or is still; its box ends `margin_mm` away."""
    timing = CycleTiming(np.array([0.0, 0.5]), 1.0) if still else CycleTiming(FRACTIONS, 0.8)
    radii = np.full(2, radius) if still else RADII * (radius / RADII[0])
    centers = np.array(center) + (np.zeros((2, 3)) if still else CENTERS)
    meshes = [sphere(r, 3, c) for r, c in zip(radii, centers, strict=True)]
    vertices = np.concatenate([mesh[0] for mesh in meshes])
    low = vertices.min(axis=0) - margin_mm
    cells = tuple(np.ceil((vertices.max(axis=0) + margin_mm - low) / KNOT).astype(int).tolist())
    return DvfModel(
        patient_id="ball",
        surface_name=name,
        frame="mr",
        timing=timing,
        es_fraction=0.3,
        ed_phase=0,
        coefficients=_fitted(low, cells, radii, centers),
        origin_mm=low,
        knot_spacing_mm=KNOT,
        reference=tuple(Mesh("mr", *mesh) for mesh in meshes),
        reference_caps=(np.zeros(len(meshes[0][1]), dtype=bool),) * len(meshes),
    )


def _fitted(origin, cells, radii, centers):
    """(n, cx, cy, cz) coefficients of the distance to a ball a phase."""
    axes = [origin[a] + 0.5 * KNOT * np.arange(2 * cells[a] + 1) for a in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    x, y, z = (AxisSolver.of(n) for n in cells)
    return np.stack(
        [
            fit_coefficients(radius - np.linalg.norm(nodes - center, axis=-1), (x, y, z))
            for radius, center in zip(radii, centers, strict=True)
        ]
    )
