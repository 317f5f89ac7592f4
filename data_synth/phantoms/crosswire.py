"""Cross-wire calibration recording: images that all pass through the crossing of two wires."""

from dataclasses import dataclass

import numpy as np

from data_synth.signals.tracker import TrackerSpec
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import FloatArray, ImageMap, InvalidInputError, Points, Rigid, Wire

from .tank import (
    TankRecording,
    looking_down,
    noisy_features,
    probe_from_plane,
    still_poses,
    tank_in_tracker,
    tracked_images,
)
from .tank_image import water_images, wire_echoes

_HALF_MM = 20.0
WIRES = (
    Wire("first", np.array([-_HALF_MM, 0.0, 0.0]), np.array([_HALF_MM, 0.0, 0.0])),
    Wire("second", np.array([0.0, -_HALF_MM, 0.0]), np.array([0.0, _HALF_MM, 0.0])),
)
"""Two wires in the horizontal plane of the tank, which meet at its origin."""


@dataclass(frozen=True, slots=True)
class CrossWireSpec:
    """Parameters of the views of the crossing.

    Attributes:
        frames: images; the probe rests `frame_s` at each.
        out_of_plane_mm: SD of the crossing's distance from the image plane.
        depth_mm: (nearest, farthest) depth of the crossing in the image; `lateral_mm` largest offset.
        tilt_deg: largest tilt of the probe; it turns freely about the vertical.
        point_noise_mm, failed_share: noise and failures of the segmentation.
    """

    frames: int = 60
    frame_s: float = 0.5
    out_of_plane_mm: float = 0.3
    depth_mm: tuple[float, float] = (35.0, 120.0)
    lateral_mm: float = 28.0
    tilt_deg: float = 25.0
    point_noise_mm: float = 0.3
    failed_share: float = 0.03

    def __post_init__(self) -> None:
        if self.frames < 1 or not 0 < self.depth_mm[0] <= self.depth_mm[1]:
            raise InvalidInputError("a cross-wire sweep needs a frame, and positive, increasing depths")


@dataclass(frozen=True, slots=True, eq=False)
class CrossWire:
    """Recording whose one feature is the crossing, with its true position in frame "tracker"."""

    recording: TankRecording
    crossing: Points


def crosswire_recording(
    probe_from_image: ImageMap,
    probe: SectorProbe,
    tracker: TrackerSpec,
    spec: CrossWireSpec,
    rng: np.random.Generator,
    *,
    rendered: bool = True,
) -> CrossWire:
    """Record tracked images with the crossing nearly in the image plane, from many directions and distances.

    Without `rendered` there are no images; everything else is the same.
    """
    mounted = probe_from_plane(probe_from_image, probe)
    tracker_from_tank = tank_in_tracker(rng)
    views = [_view(probe, spec, rng) for _ in range(spec.frames)]
    stream = still_poses(
        [tracker_from_tank @ view @ mounted.inverse() for view in views], spec.frame_s, tracker, rng
    )
    crossing = np.stack([view.inverse().translation_mm for view in views])
    exact = np.asarray(probe.apex_px) + crossing[:, None, :2] / probe.mm_per_px
    seed = int(rng.integers(2**31))
    images = None
    if rendered:
        images = water_images(probe, [wire_echoes(WIRES, v.inverse(), probe, seed) for v in views], seed)
    features = noisy_features(exact, probe_from_image, spec.point_noise_mm, spec.failed_share, rng)
    recording = TankRecording(tracked_images(stream, images), probe.fan, features, exact)
    return CrossWire(recording, tracker_from_tank.apply(Points("tank", np.zeros((1, 3)))))


def _view(probe: SectorProbe, spec: CrossWireSpec, rng: np.random.Generator) -> Rigid:
    """Draw tank_from_plane with the tank's origin at a random position in the image."""
    seen_at: FloatArray = np.array(
        [
            rng.uniform(-1, 1) * spec.lateral_mm,
            rng.uniform(*spec.depth_mm),
            spec.out_of_plane_mm * rng.standard_normal(),
        ]
    )
    # stay inside the sector
    seen_at[0] = np.clip(seen_at[0], *(seen_at[1] * np.tan(0.9 * probe.half_angle_rad) * np.array([-1, 1])))
    rotation = looking_down(rng, spec.tilt_deg)
    return Rigid("tank", "plane", rotation, -rotation @ seen_at)
