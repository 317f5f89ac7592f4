"""Ground truth that a replay has to estimate: frames, image calibration, tool tip, latency; coarse starts."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.ultrasound.image_probe import CalibratedImage
from dvf_ig.core import FloatArray, ImageMap, Landmarks, Points, Rigid

from .displacement import random_displacement

LANDMARK_RMS_MM = 3.0
"""RMS 3-D error of a touched landmark; each axis has an SD of this over √3."""
STYLUS_RMS_MM = 0.7
"""RMS 3-D error of a point of the surface under a calibrated stylus."""
OPENED, FRONT_SHARE = np.array([0.5, -0.84, -0.2]), 0.2
"""Direction (LPS) from the heart's middle to the opening of the chest, and the least cosine between it and
that to a place that can be touched."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """Unknowns of one synthetic operating room.

    Attributes:
        mr_from_tracker: any rotation, the heart some 0.5 to 0.9 m from the tracker's origin.
        probe_from_image: image calibration; `probe_from_plane` is the same pose from the fan apex, in mm.
        tip_in_tool: one point in frame "tool".
        lag_s: t_tracker(event) = t_video(event) + lag_s; between 20 and 80 ms, either sign.
    """

    mr_from_tracker: Rigid
    probe_from_image: ImageMap
    probe_from_plane: Rigid
    tip_in_tool: Points
    lag_s: float

    def with_image(self, image: CalibratedImage) -> "GroundTruth":
        """Replace the probe by one whose calibration is known."""
        return replace(self, probe_from_image=image.probe_from_image, probe_from_plane=image.probe_from_plane)


def draw_ground_truth(
    center_mr_mm: FloatArray, plane_from_image: ImageMap, tool_mm: float, rng: np.random.Generator
) -> GroundTruth:
    """Draw all unknowns.

    Args:
        center_mr_mm: (3,) heart centre.
        plane_from_image: pixel to in-plane mm, origin at the fan apex.
        tool_mm: approximate length of the tool.
    """
    turn = Rotation.random(rng=rng).as_matrix()
    heart_in_tracker = rng.uniform((-150.0, -150.0, -850.0), (150.0, 150.0, -500.0))
    tracker_from_mr = Rigid("tracker", "mr", turn, heart_in_tracker - turn @ center_mr_mm)
    mount = Rotation.from_euler("zyx", rng.uniform(-25, 25, 3), degrees=True)
    upright = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    apex_in_probe = rng.uniform((-15.0, 30.0, -15.0), (15.0, 70.0, 15.0))
    rotation = mount.as_matrix() @ upright
    probe_from_plane = Rigid("probe", "plane", rotation, apex_in_probe)
    probe_from_image = ImageMap(probe_from_plane @ plane_from_image.rigid, plane_from_image.scale_mm_per_px)
    tip = rng.uniform((-20.0, -20.0, 0.95 * tool_mm), (20.0, 20.0, 1.05 * tool_mm))
    lag_s = float(rng.choice((-1.0, 1.0)) * rng.uniform(0.02, 0.08))
    return GroundTruth(
        tracker_from_mr.inverse(), probe_from_image, probe_from_plane, Points("tool", tip[None]), lag_s
    )


def touched_landmarks(landmarks_mr: Landmarks, mr_from_tracker: Rigid, rng: np.random.Generator) -> Landmarks:
    """Simulate an operator's touching of the points with a stylus, frame "tracker"."""
    exact = mr_from_tracker.inverse().apply(landmarks_mr.points).xyz_mm
    error = rng.standard_normal(exact.shape) * (LANDMARK_RMS_MM / np.sqrt(3))
    return Landmarks(landmarks_mr.names, Points("tracker", exact + error))


def touched_surface(
    vertices_mm: FloatArray, count: int, mr_from_tracker: Rigid, rng: np.random.Generator
) -> Points | None:
    """Simulate the touching of places of the surface that an open chest shows; None if there are none.

    Args:
        vertices_mm: (n, 3) of the patient's epicardium at end-diastole, frame "mr".
    """
    if not count:
        return None
    away = vertices_mm - vertices_mm.mean(axis=0)
    front = np.flatnonzero(away @ OPENED > FRONT_SHARE * np.linalg.norm(away, axis=1))
    exact = mr_from_tracker.inverse().apply_array(vertices_mm[rng.choice(front, count)])
    return Points("tracker", exact + rng.standard_normal(exact.shape) * (STYLUS_RMS_MM / np.sqrt(3)))


def coarse_start(
    mr_from_tracker: Rigid,
    center_mr_mm: FloatArray,
    offset_mm: float,
    offset_deg: float,
    rng: np.random.Generator,
) -> Rigid:
    """Turn the true pose by exactly `offset_deg` about the heart's centre and move it by `offset_mm`."""
    turn_rad, shift_mm = random_displacement(rng, shift_mm=offset_mm, turn_deg=offset_deg)
    return mr_from_tracker.perturbed_left(turn_rad, shift_mm, center_mr_mm)
