"""Tracked images of a calibration phantom in a water tank, shared by its kinds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_synth.signals.tracker import TrackerSpec, tracked
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import Fan, FloatArray, ImageMap, PoseStream, Rigid, TrackedSequence, read_only_arrays

DOWN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""tank_from_plane of a probe held upright: the depth axis points down."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TankRecording:
    """Recording of one phantom.

    Attributes:
        sequence: images (or None), with tracker_from_probe at their times (video and tracker clocks agree).
        fan: the insonified sector.
        features_px: (n, k, 2) column and row of each feature as segmented, with its noise; NaN if not
            found.
        exact_px: (n, k, 2) the same without noise.
    """

    sequence: TrackedSequence
    fan: Fan
    features_px: FloatArray
    exact_px: FloatArray


def probe_from_plane(probe_from_image: ImageMap, probe: SectorProbe) -> Rigid:
    """Compute probe_from_plane: the image calibration from the fan apex, in mm."""
    return probe_from_image.rigid @ probe.plane_from_image.rigid.inverse()


def tank_in_tracker(rng: np.random.Generator) -> Rigid:
    """Draw tracker_from_tank: somewhere in front of the tracker, in any orientation."""
    turn = Rotation.random(rng=rng).as_matrix()
    return Rigid("tracker", "tank", turn, rng.uniform((-200.0, -200.0, -900.0), (200.0, 200.0, -500.0)))


def looking_down(rng: np.random.Generator, tilt_deg: float) -> FloatArray:
    """Draw the (3, 3) rotation of tank_from_plane: any turn about the vertical, tilt up to `tilt_deg`."""
    turn = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
    tilt = Rotation.from_euler("xz", np.deg2rad(tilt_deg) * rng.uniform(-1, 1, 2))
    return np.asarray((turn * Rotation.from_matrix(DOWN) * tilt).as_matrix())


def still_poses(
    poses: Sequence[Rigid], frame_s: float, tracker: TrackerSpec, rng: np.random.Generator
) -> PoseStream:
    """Track a probe that rests at one pose after the other; `tracker.rate_hz` is not used."""
    t_s = np.round(frame_s * np.arange(len(poses)), 6)
    rotations = np.stack([pose.rotation for pose in poses])
    translations = np.stack([pose.translation_mm for pose in poses])
    first = poses[0]
    return tracked(lambda _: (rotations, translations), first.target, first.source, t_s, t_s, tracker, rng)


def tracked_images(stream: PoseStream, images: NDArray[np.uint8] | None) -> TrackedSequence:
    """Combine images with the poses recorded with them."""
    return TrackedSequence(stream.t_s, images, np.ones(len(stream), dtype=np.bool_), {stream.name: stream})


def noisy_features(
    exact_px: FloatArray, image: ImageMap, noise_mm: float, failed_share: float, rng: np.random.Generator
) -> FloatArray:
    """Simulate a segmentation: noise in mm, and failed frames without any feature."""
    noisy = exact_px + rng.standard_normal(exact_px.shape) * (noise_mm / image.scale_mm_per_px)
    noisy[rng.uniform(size=len(exact_px)) < failed_share] = np.nan
    return noisy
