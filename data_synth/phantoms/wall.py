"""Wall calibration recording: a flat wall seen as a line from many directions."""

from dataclasses import dataclass

import numpy as np

from data_synth.signals.tracker import TrackerSpec
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import FloatArray, ImageMap, InvalidInputError, Rigid, read_only_arrays

from .tank import (
    TankRecording,
    looking_down,
    noisy_features,
    probe_from_plane,
    still_poses,
    tank_in_tracker,
    tracked_images,
)
from .tank_image import wall_echoes, water_images


@dataclass(frozen=True, slots=True)
class WallSpec:
    """Parameters of the views of the wall.

    Attributes:
        frames: images; the probe rests `frame_s` at each.
        depth_mm: (nearest, farthest) depth of the wall in the middle of the image.
        tilt_deg: largest angle between the wall's normal and the middle line, each way.
        half_span_mm: lateral distance of the two segmented points of the line from the image's middle.
        point_noise_mm, failed_share: noise and failures of the segmentation.
    """

    frames: int = 60
    frame_s: float = 0.5
    depth_mm: tuple[float, float] = (40.0, 115.0)
    tilt_deg: float = 35.0
    half_span_mm: float = 12.0
    point_noise_mm: float = 0.3
    failed_share: float = 0.03

    def __post_init__(self) -> None:
        if self.frames < 1 or not 0 < self.depth_mm[0] <= self.depth_mm[1] or not 0 <= self.tilt_deg <= 45:
            raise InvalidInputError(
                "a wall sweep needs a frame, positive, increasing depths and a tilt of 0 to 45°"
            )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Wall:
    """Recording (two points of the line in each image), with the wall in frame "tracker".

    Attributes:
        normal: (3,) unit normal towards the probe.
        offset_mm: normal · x on the wall.
    """

    recording: TankRecording
    normal: FloatArray
    offset_mm: float


def wall_recording(
    probe_from_image: ImageMap,
    probe: SectorProbe,
    tracker: TrackerSpec,
    spec: WallSpec,
    rng: np.random.Generator,
    *,
    rendered: bool = True,
) -> Wall:
    """Record tracked images of the floor z = 0 of a tank; without `rendered` there are no images."""
    mounted = probe_from_plane(probe_from_image, probe)
    tracker_from_tank = tank_in_tracker(rng)
    views = [_view(spec, rng) for _ in range(spec.frames)]
    stream = still_poses(
        [tracker_from_tank @ view @ mounted.inverse() for view in views], spec.frame_s, tracker, rng
    )
    seed = int(rng.integers(2**31))
    images = None
    if rendered:
        speckle = np.random.default_rng(seed)
        echoes = [wall_echoes(view.rotation[2], -view.translation_mm[2], probe, speckle) for view in views]
        images = water_images(probe, echoes, seed)
    exact = np.stack([_line_px(view, probe, spec) for view in views])
    features = noisy_features(exact, probe_from_image, spec.point_noise_mm, spec.failed_share, rng)
    recording = TankRecording(tracked_images(stream, images), probe.fan, features, exact)
    normal = tracker_from_tank.rotation[:, 2]
    return Wall(recording, normal, float(normal @ tracker_from_tank.translation_mm))


def _view(spec: WallSpec, rng: np.random.Generator) -> Rigid:
    """Draw tank_from_plane: looking down on the floor."""
    rotation = looking_down(rng, spec.tilt_deg)
    height = rng.uniform(*spec.depth_mm) * -rotation[2, 1]
    return Rigid("tank", "plane", rotation, np.array([*rng.uniform(-30, 30, 2), height]))


def _line_px(tank_from_plane: Rigid, probe: SectorProbe, spec: WallSpec) -> FloatArray:
    """Compute the line's (2, 2) pixels left and right of the image's middle."""
    normal, height = tank_from_plane.rotation[2], tank_from_plane.translation_mm[2]
    x = np.array([-spec.half_span_mm, spec.half_span_mm])
    y = -(height + normal[0] * x) / normal[1]
    return np.asarray(probe.apex_px + np.column_stack([x, y]) / probe.mm_per_px)
