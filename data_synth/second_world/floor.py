"""Lower bound of rigid registration: the fit with every point of every image matched to itself."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Landmarks, Rigid

from .changed_heart import best_rigid
from .operating_room import OperatingRoom

_PER_IMAGE = 40


@dataclass(frozen=True, slots=True)
class RigidFloor:
    """Part of the error that no rigid registration of a recording can remove.

    Attributes:
        changed_rms_mm: RMS distance of the heart's moving surface from that of the MR after its best rigid
            fit: mismatch, volume load, contractility and dyssynchrony.
        pose_mm, pose_deg: mean error at the targets, and angle, of the pose that fits every point of the
            heart in every image to its own position in the MR. It comes from the distorted field, drift,
            speed of sound, calibration and lag, and from the part of the change that the images show.
        residual_mm: RMS distance of these points at that pose.
    """

    changed_rms_mm: float
    pose_mm: float
    pose_deg: float
    residual_mm: float


def rigid_floor(room: OperatingRoom, taken_s: FloatArray) -> RigidFloor:
    """Compute the floor of images taken at (n,) times, without noise that averages out."""
    matched = matched_points(room, taken_s)
    return floor_of(*matched, room.heart.targets, room.mr_from_tracker, room.changed_rms_mm)


def floor_of(
    seen_mm: FloatArray, meant_mm: FloatArray, targets: Landmarks, truth: Rigid, changed_rms_mm: float
) -> RigidFloor:
    """Compute the floor from (n, 3) points placed by images, frame "tracker", and by MR, frame "mr"."""
    best = best_rigid(seen_mm, meant_mm, "mr", "tracker")
    rest = best.apply_array(seen_mm) - meant_mm
    there = truth.inverse().apply(targets.points).xyz_mm
    off = np.linalg.norm(best.apply_array(there) - targets.points.xyz_mm, axis=1)
    turned = best @ truth.inverse()
    return RigidFloor(
        changed_rms_mm,
        float(off.mean()),
        float(np.rad2deg(turned.angle_rad)),
        float(np.sqrt((rest**2).sum(axis=1).mean())),
    )


def matched_points(room: OperatingRoom, taken_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Match (n, 3) points of the heart placed by the images, frame "tracker", to their positions in the MR.

    The second are in frame "mr" at the phase of the image.
    """
    rng, probe, drawn = room.rng("floor"), room.probe, room.drawn
    count = len(taken_s)
    depth = probe.depth_mm * np.sqrt(rng.uniform(0.0, 1.0, (count, _PER_IMAGE)))
    angle = probe.half_angle_rad * rng.uniform(-1.0, 1.0, (count, _PER_IMAGE))
    shown = np.stack([depth * np.sin(angle), depth * np.cos(angle), np.zeros_like(depth)], axis=-1)
    turns, places = room.mr_from_plane(taken_s)
    true = _placed(turns, places, shown * (1.0 + drawn["image.sound_speed"]))
    read_at = taken_s + drawn["calibration.lag_error_s"]
    turns, places = room.tracker_from_probe(read_at)
    plane = room.calibrated.rigid @ probe.plane_from_image.rigid.inverse()
    seen = _placed(turns, places, plane.apply_array(shown.reshape(-1, 3)).reshape(shown.shape))
    phases = np.repeat(room.clock.model_phase(taken_s), _PER_IMAGE)
    material = room.changed.inverse_motion.pull_back(true.reshape(-1, 3), phases)
    in_heart = room.heart.shapes.organ(material) > 0
    meant = room.heart.resting_motion.push_forward(material[in_heart], phases[in_heart])
    return seen.reshape(-1, 3)[in_heart], meant


def _placed(turns: FloatArray, places: FloatArray, points: FloatArray) -> FloatArray:
    """Move (n, k, 3) points by n poses."""
    return np.asarray(np.einsum("nij,nkj->nki", turns, points) + places[:, None])
