"""Source of all streams of a scenario: heart, beats, probe, true frames and their changes."""

from dataclasses import dataclass

import numpy as np

from data_synth.breathing.breaths import Breaths
from data_synth.breathing.motion import Breathing, breathing_of
from data_synth.heart.beating_anatomy import BeatingAnatomy
from data_synth.heart.clock import HeartClock
from data_synth.heart.tissue import Tissue
from data_synth.operator.contact import MovingSurface
from data_synth.operator.probe_path import CENTRAL_STANDOFF_MM, STANDOFF_MM, HeartOutline, acoustic_window
from data_synth.seeds import child_rng
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import FloatArray, ImageMap, read_only_arrays

from .displacement import DisplacedPose, Displacement, displaced
from .ground_truth import GroundTruth, draw_ground_truth
from .presets import Preset, ScenarioSpec

ANTERIOR_LEFT = np.array([0.52, -0.83, -0.20])
"""Preferred acoustic window in LPS: from the left front, slightly below."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Synthetic operating room.

    Attributes:
        spec: specification.
        anatomy, clock, surface, outline: the beating heart, at rest in breathing.
        window: (3,) direction of the acoustic window from the heart.
        probe: the scanner.
        truth: values that a replay has to estimate, at the beginning.
        patient: mr_from_tracker over time.
        mount: probe_from_plane over time.
        calibrated: image calibration of the probe in the calibration recordings.
        breathing: motion of the heart in breathing; None without.
    """

    spec: ScenarioSpec
    anatomy: BeatingAnatomy
    clock: HeartClock
    surface: MovingSurface
    outline: HeartOutline
    window: FloatArray
    probe: SectorProbe
    truth: GroundTruth
    patient: DisplacedPose
    mount: DisplacedPose
    calibrated: ImageMap
    breathing: Breathing | None

    @property
    def options(self) -> Preset:
        return self.spec.options

    @property
    def standoff_mm(self) -> tuple[float, float]:
        """Smallest and largest distance of the fan apex from the heart in a sweep."""
        near, far = STANDOFF_MM
        return self._apex_at(near), self._apex_at(far)

    @property
    def central_standoff_mm(self) -> float:
        """Distance of the fan apex from the heart in a single view."""
        return self._apex_at(CENTRAL_STANDOFF_MM)

    def _apex_at(self, standoff_mm: float) -> float:
        """Scale a standoff to keep the standard probe's share of the image's depth before the heart."""
        return self.probe.face_radius_mm + standoff_mm * (self.probe.depth_mm / SectorProbe().depth_mm)

    def rng(self, stream: str) -> np.random.Generator:
        return child_rng(self.spec.seed, stream)

    def image_maps(self) -> tuple[tuple[float, ImageMap], ...]:
        """List the image calibrations with their start times; the first is that of `truth`."""
        plane_from_image = self.probe.plane_from_image
        return tuple(
            (start_s, ImageMap(pose @ plane_from_image.rigid, plane_from_image.scale_mm_per_px))
            for start_s, pose in self.mount.steps()
        )


def make_world(spec: ScenarioSpec, anatomy: BeatingAnatomy, r_peaks_s: FloatArray, breaths: Breaths) -> World:
    """Draw everything that does not depend on the paths of probe and tool.

    Args:
        r_peaks_s: true beats on the tracker's clock.
        breaths: course of breathing.
    """
    surface = MovingSurface.of(anatomy)
    resting = surface.vertices_mm[0]
    outline = HeartOutline(resting.mean(axis=0), resting)
    window = acoustic_window(
        lambda xyz: np.isin(anatomy.tissue(xyz, 0.0), (int(Tissue.LUNG), int(Tissue.BONE))).astype(
            np.float64
        ),
        outline,
        ANTERIOR_LEFT / np.linalg.norm(ANTERIOR_LEFT),
    )
    probe = SectorProbe() if spec.image is None else spec.image.probe
    options = spec.options
    center = anatomy.box_mm.mean(axis=0)
    truth = draw_ground_truth(
        center, probe.plane_from_image, options.tool.length_mm, child_rng(spec.seed, "planting")
    )
    if spec.image is not None:
        truth = truth.with_image(spec.image)
    middle = image_middle_mm(truth.probe_from_image, probe)
    return World(
        spec=spec,
        anatomy=anatomy,
        clock=HeartClock(r_peaks_s, anatomy.rr_s, anatomy.es_fraction),
        surface=surface,
        outline=outline,
        window=window,
        probe=probe,
        truth=truth,
        patient=displaced(
            truth.mr_from_tracker,
            options.patient_shift.drawn(child_rng(spec.seed, "patient shift size")),
            center,
            spec.seconds,
            child_rng(spec.seed, "patient shift"),
        ),
        mount=displaced(
            truth.probe_from_plane,
            options.probe_slip.drawn(child_rng(spec.seed, "probe slip size")),
            middle,
            spec.seconds,
            child_rng(spec.seed, "probe slip"),
        ),
        calibrated=_other_probe(truth.probe_from_image, options, middle, child_rng(spec.seed, "other probe")),
        breathing=breathing_of(options.respiration, breaths, center, child_rng(spec.seed, "breathing")),
    )


def image_middle_mm(probe_from_image: ImageMap, probe: SectorProbe) -> FloatArray:
    """Compute the (3,) middle of the image in frame "probe"."""
    middle = 0.5 * np.array([[probe.columns - 1.0, probe.rows - 1.0]])
    return np.asarray(probe_from_image.apply_pixels(middle).xyz_mm[0])


def _other_probe(
    image: ImageMap, options: Preset, middle_mm: FloatArray, rng: np.random.Generator
) -> ImageMap:
    """Choose the recorded image calibration: the true one, or another probe's."""
    change = Displacement(0.0, options.other_probe_mm, options.other_probe_deg)
    return ImageMap(displaced(image.rigid, change, middle_mm, 0.0, rng).steps()[-1][1], image.scale_mm_per_px)
