"""N-wire calibration recording: exact wire crossings of the image plane, with pixel and tracker noise.

Wires as in the fCal 2.0 phantom (PLUS; Lasso et al., IEEE TBME 61:2527, 2014): three N patterns, each with
two parallel wires along y and a diagonal, 40 mm long, at three heights.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.signals.tracker import TrackerSpec
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import (
    Fan,
    FloatArray,
    ImageMap,
    InvalidInputError,
    NWirePhantom,
    NWireRecording,
    Rigid,
    TrackedSequence,
    Wire,
)

from .tank import noisy_features, probe_from_plane, still_poses, tracked_images
from .tank_image import water_images, wire_echoes

_LENGTH_MM = 40.0
_PATTERNS: tuple[tuple[float, tuple[tuple[str, float, float], ...]], ...] = (
    (20.0, (("7:G1_g1", 30.0, 30.0), ("8:L1_h1", 55.0, 35.0), ("9:M1_m1", 60.0, 60.0))),
    (10.0, (("4:G3_g3", 30.0, 30.0), ("5:H3_l3", 35.0, 55.0), ("6:M3_m3", 60.0, 60.0))),
    (0.0, (("1:H5_h5", 35.0, 35.0), ("2:L5_i5", 55.0, 40.0), ("3:M5_m5", 60.0, 60.0))),
)
"""Height z of each pattern, and name, x at y = 0 and x at y = 40 mm of its wires."""


@dataclass(frozen=True, slots=True)
class NWireSpec:
    """Parameters of the sweep over the phantom.

    Attributes:
        frames: images with all wires in view.
        frame_s: time from one image to the next; the probe rests at each.
        point_noise_mm: SD of a segmented point along columns and along rows.
        failed_share: share of images whose segmentation failed.
        top_depth_mm: (nearest, farthest) depth in the image of the phantom's upper wires.
        lateral_mm: largest offset of the phantom from the image's middle.
        tilt_deg: largest tilt about each in-plane axis; `turn_deg` about the image normal.
    """

    frames: int = 120
    frame_s: float = 0.25
    point_noise_mm: float = 0.2
    failed_share: float = 0.04
    top_depth_mm: tuple[float, float] = (30.0, 105.0)
    lateral_mm: float = 30.0
    tilt_deg: float = 18.0
    turn_deg: float = 22.0


def fcal_phantom() -> NWirePhantom:
    """Build the wires of the fCal 2.0 phantom in frame "phantom"."""
    patterns = []
    for z, wires in _PATTERNS:
        left, middle, right = (
            Wire(name, np.array([front, 0.0, z]), np.array([back, _LENGTH_MM, z]))
            for name, front, back in wires
        )
        patterns.append((left, middle, right))
    return NWirePhantom(tuple(patterns))


def wire_crossings_px(phantom: NWirePhantom, phantom_from_image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Intersect the wires with the image plane.

    Args:
        phantom_from_image: (..., 4, 4) mm per pixel.
    Returns:
        (..., wires, 2) column and row, and (..., wires) the fraction along each wire from front to back.
    """
    front = np.stack([wire.front_mm for wire in phantom.wires])
    along = np.stack([wire.back_mm for wire in phantom.wires]) - front
    m = np.asarray(phantom_from_image)[..., None, :3, :]
    columns = np.stack(np.broadcast_arrays(m[..., 0], m[..., 1], -along), axis=-1)
    solved = np.linalg.solve(columns, (front - m[..., 3])[..., None])[..., 0]
    return solved[..., :2], solved[..., 2]


def nwire_recording(
    probe_from_image: ImageMap,
    fan: Fan,
    image_size_px: tuple[int, int],
    tracker: TrackerSpec,
    spec: NWireSpec,
    rng: np.random.Generator,
) -> NWireRecording:
    """Record images of the phantom with every wire inside the sector and crossed within its length.

    Args:
        image_size_px: (columns, rows).

    Raises:
        InvalidInputError: the sector cannot hold the phantom.
    """
    poses, points = _placements(fcal_phantom(), probe_from_image, fan, image_size_px, spec, rng)
    return _recorded(poses, points, probe_from_image, tracker, spec, rng)


def nwire_images(
    probe_from_image: ImageMap,
    probe: SectorProbe,
    tracker: TrackerSpec,
    spec: NWireSpec,
    rng: np.random.Generator,
) -> tuple[NWireRecording, TrackedSequence]:
    """Make the recording of `nwire_recording` (from the same `rng`) together with its images.

    Returns:
        The recording, and its images with phantom_from_probe at their times.
    """
    phantom = fcal_phantom()
    size = (probe.columns, probe.rows)
    poses, points = _placements(phantom, probe_from_image, probe.fan, size, spec, rng)
    recording = _recorded(poses, points, probe_from_image, tracker, spec, rng)
    mounted = probe_from_plane(probe_from_image, probe)
    seed = int(rng.integers(2**31))
    frames = [wire_echoes(phantom.wires, (pose @ mounted).inverse(), probe, seed) for pose in poses]
    return recording, tracked_images(recording.phantom_from_probe, water_images(probe, frames, seed))


def _recorded(
    poses: list[Rigid],
    points: FloatArray,
    probe_from_image: ImageMap,
    tracker: TrackerSpec,
    spec: NWireSpec,
    rng: np.random.Generator,
) -> NWireRecording:
    measured = still_poses(poses, spec.frame_s, tracker, rng)
    noisy = noisy_features(points, probe_from_image, spec.point_noise_mm, spec.failed_share, rng)
    return NWireRecording(fcal_phantom(), measured, noisy)


def _placements(
    phantom: NWirePhantom,
    probe_from_image: ImageMap,
    fan: Fan,
    image_size_px: tuple[int, int],
    spec: NWireSpec,
    rng: np.random.Generator,
) -> tuple[list[Rigid], FloatArray]:
    """Draw phantom_from_probe and crossings (frames, wires, 2) of frames that show all wires."""
    scale = np.diag([*probe_from_image.scale_mm_per_px, 1.0, 1.0])
    image_from_probe = probe_from_image.rigid.inverse()
    poses: list[Rigid] = []
    points: list[FloatArray] = []
    for _ in range(200 * spec.frames):
        phantom_from_image = _random_view(probe_from_image, fan, spec, rng)
        pixels, fraction = wire_crossings_px(phantom, phantom_from_image.matrix @ scale)
        if ((fraction > 0.03) & (fraction < 0.97)).all() and _in_sector(pixels, fan, image_size_px):
            poses.append(phantom_from_image @ image_from_probe)
            points.append(pixels)
        if len(poses) == spec.frames:
            return poses, np.stack(points)
    raise InvalidInputError(
        f"only {len(poses)} of {spec.frames} random views hold all wires of the phantom in the sector; "
        "use a wider or deeper sector"
    )


def _random_view(probe_from_image: ImageMap, fan: Fan, spec: NWireSpec, rng: np.random.Generator) -> Rigid:
    """Draw phantom_from_image (image in mm from pixel 0, 0): looking down on the wires, across them."""
    middle = np.array([rng.uniform(40.0, 50.0), rng.uniform(10.0, 30.0), 20.0])
    facing = Rotation.from_matrix(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]))
    turn, tilt, yaw = np.deg2rad([spec.turn_deg, spec.tilt_deg, spec.tilt_deg]) * rng.uniform(-1, 1, 3)
    rotation = (facing * Rotation.from_euler("zxy", [turn, tilt, yaw])).as_matrix()
    apex_mm = fan.apex_px * probe_from_image.scale_mm_per_px
    seen_at = np.array(
        [apex_mm[0] + rng.uniform(-1, 1) * spec.lateral_mm, apex_mm[1] + rng.uniform(*spec.top_depth_mm), 0.0]
    )
    return Rigid("phantom", probe_from_image.rigid.source, rotation, middle - rotation @ seen_at)


def _in_sector(pixels: FloatArray, fan: Fan, image_size_px: tuple[int, int]) -> bool:
    offset = pixels - fan.apex_px
    radius, angle = np.hypot(offset[:, 0], offset[:, 1]), np.abs(np.arctan2(offset[:, 0], offset[:, 1]))
    inside = (radius > fan.start_px + 2) & (radius < fan.stop_px - 2) & (angle < 0.97 * fan.half_angle_rad)
    on_image = (pixels >= 0).all() and (pixels <= np.array(image_size_px) - 1).all()
    return bool(inside.all() and on_image)
