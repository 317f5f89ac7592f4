"""A flat wall that may beat: its distance field is linear in place, so its coefficients are exact."""

import numpy as np

from dvf_ig.core import CycleTiming, DvfModel, Mesh

KNOT_MM = 5.0
CELLS = 16
HALF_MM = 0.5 * KNOT_MM * CELLS


def wall_model(amplitude_mm: float = 0.0, *, phases: int = 20, rr_s: float = 0.6) -> DvfModel:
    """The half-space x > 0 is the organ: d = x, or d = x − x_w(φ) with x_w = ½A(1 − cos 2πφ).

    Args:
        amplitude_mm: A, from end to end of the wall's motion.
        phases: of the cycle.
        rr_s: its length.
    """
    place = KNOT_MM * (np.arange(CELLS + 3) - 1.0) - HALF_MM
    wall = 0.5 * amplitude_mm * (1.0 - np.cos(2.0 * np.pi * np.arange(phases) / phases))
    shape = (phases, CELLS + 3, CELLS + 3, CELLS + 3)
    field = place[None, :, None, None] - wall[:, None, None, None]
    triangle = Mesh("mr", np.eye(3), np.array([[0, 1, 2]]))
    return DvfModel(
        patient_id="wall",
        surface_name="WALL",
        frame="mr",
        timing=CycleTiming.uniform(phases, rr_s),
        es_fraction=0.4,
        ed_phase=0,
        coefficients=np.broadcast_to(field, shape).astype(np.float32),
        origin_mm=np.full(3, -HALF_MM),
        knot_spacing_mm=KNOT_MM,
        reference=(triangle,) * phases,
        reference_caps=(np.zeros(1, dtype=np.bool_),) * phases,
    )
