"""Named points of the heart: targets of the registration, and those a stylus can touch."""

import numpy as np

from data_synth.kernels import lv
from dvf_ig.core import FloatArray, Landmarks, Points

from .shapes import HeartShape

TOUCHABLE = (
    "apex",
    "rv_apex",
    "rv_insertion_anterior",
    "rv_insertion_inferior",
    "laa_tip",
    "aortic_root",
    "pulmonary_root",
    "right_atrium",
)
"""Targets on the outer surface that an operator could touch with a stylus."""


def heart_landmarks(h: HeartShape) -> tuple[tuple[str, ...], FloatArray]:
    """List names and (n, 3) positions of anatomical points of the standard heart at end-diastole."""
    base = lv.BASE
    mitral = np.array([h.la_center[0] * 0.7, h.la_center[1] * 0.7, base])
    tricuspid = np.array([h.ra_center[0], h.ra_center[1], base])
    points = {
        "apex": np.zeros(3),
        "apex_endocardial": np.array([0.0, 0.0, h.lv_cavity[1]]),
        "mitral_lateral": mitral + np.array([-14.0, 0.0, 0.0]),
        "mitral_anterior": mitral + np.array([0.0, 13.0, 0.0]),
        "mitral_inferior": mitral + np.array([0.0, -13.0, 0.0]),
        "tricuspid_lateral": tricuspid + np.array([13.0, 0.0, 0.0]),
        "tricuspid_septal": tricuspid + np.array([-11.0, 0.0, 0.0]),
        "rv_apex": h.rv_center + np.array([12.0, 0.0, -0.85 * h.rv_semi[2]]),
        "rv_insertion_anterior": np.array([11.0, 29.0, 50.0]),
        "rv_insertion_inferior": np.array([11.0, -29.0, 50.0]),
        "laa_ostium": h.laa_path[0],
        "laa_tip": h.laa_path[-1] + np.array([0.0, 4.0, -2.0]),
        "aortic_valve": np.array([h.aorta_path[0][0], h.aorta_path[0][1], base]),
        "aortic_root": h.aorta_path[1] + np.array([3.0, 12.0, 8.0]),
        "pulmonary_root": h.pulmonary_path[1] + np.array([6.0, 10.0, 3.0]),
        "right_atrium": h.ra_center + h.ra_semi * np.array([0.8, -0.4, 0.0]),
    }
    return tuple(points), np.array(list(points.values()))


def with_box_grid(frame: str, names: tuple[str, ...], points: FloatArray, box_mm: FloatArray) -> Landmarks:
    """Append to named points the 27 nodes (corners, mid-edges, faces, centre) of the heart box."""
    axes = [np.linspace(box_mm[0, k], box_mm[1, k], 3) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    labels = tuple(f"box_{i}{j}{k}" for i in range(3) for j in range(3) for k in range(3))
    return Landmarks(names + labels, Points(frame, np.concatenate([points, grid])))
