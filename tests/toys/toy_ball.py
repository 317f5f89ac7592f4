"""A beating, drifting ball whose distance field is known in closed form."""

import numpy as np

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
    axes = [ORIGIN[a] + 0.5 * KNOT * np.arange(2 * CELLS[a] + 1) for a in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    x, y, z = (AxisSolver.of(n) for n in CELLS)
    coefficients = [
        fit_coefficients(radius - np.linalg.norm(nodes - center, axis=-1), (x, y, z))
        for radius, center in zip(RADII, CENTERS, strict=True)
    ]
    triangle = Mesh("mr", np.array([[-31.0, 0, 0], [31, 0, 0], [0, 31, 0]]), np.array([[0, 1, 2]]))
    return DvfModel(
        patient_id="ball",
        surface_name="EPICARDIAL",
        frame="mr",
        timing=CycleTiming(FRACTIONS, 0.8),
        es_fraction=0.3,
        ed_phase=0,
        coefficients=np.stack(coefficients),
        origin_mm=ORIGIN,
        knot_spacing_mm=KNOT,
        reference=(triangle,) * 4,
        reference_caps=(np.zeros(1, dtype=bool),) * 4,
    )
