"""Unknowns of one operating room of the second world, and the source of its streams."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.breathing.breaths import BreathKind, Breaths, BreathSpec, draw_breaths
from data_synth.breathing.motion import Breathing, breathing_of
from data_synth.operator.contact import MovingSurface
from data_synth.operator.pose_path import composed
from data_synth.scenario.displacement import random_displacement
from data_synth.seeds import child_rng
from data_synth.signals.rhythm import Beats, RhythmSpec, beat_series
from data_synth.signals.tracker import PosePath
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.core import FloatArray, ImageMap, Points, Rigid, read_only_arrays

from .changed_heart import ChangedHeart, changed_heart
from .clock import CycleLaw, NoisyClock
from .drawn import Drawn
from .measured_poses import DistortedField, distorted_field
from .probes import drawn_probe
from .resting_heart import RestingHeart, box_of
from .sweeps import sweep
from .tissue_fields import TissueFields, tissue_fields

TOOL_MM = 180.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class OperatingRoom:
    """Operating room: heart, its beat, the probe over it, and the frames that a registration estimates.

    Attributes:
        heart, fields: before the intervention.
        changed, surface, changed_rms_mm: the heart under the probe, and the distance of its surface from
            before.
        beats, clock: ECG and muscle.
        probe: nominal geometry of the scanner.
        mr_from_plane: true pose of its image; `window` (3,) the direction from the heart to it.
        mr_from_tracker: the true pose.
        probe_from_plane, calibrated: true mounting, and the one in the calibration recordings.
        tip: tool tip, frame "tool".
        lag_s: t_tracker(event) = t_video(event) + lag_s.
        field: the tracker's distorted field.
        drawn: every value of this heart.
        breathing: motion of the heart in breathing; None without.
    """

    heart: RestingHeart
    fields: TissueFields
    changed: ChangedHeart
    surface: MovingSurface
    changed_rms_mm: float
    beats: Beats
    clock: NoisyClock
    probe: SectorProbe
    mr_from_plane: PosePath
    window: FloatArray
    mr_from_tracker: Rigid
    probe_from_plane: Rigid
    calibrated: ImageMap
    tip: Points
    lag_s: float
    field: DistortedField
    drawn: Drawn
    breathing: Breathing | None = None

    @property
    def probe_from_image(self) -> ImageMap:
        """True image calibration."""
        return image_map(self.probe_from_plane, self.probe)

    @property
    def tracker_from_probe(self) -> PosePath:
        """Tracked pose of the probe as read, before noise."""
        fixed = constant_path(self.mr_from_tracker.inverse())
        mount = constant_path(self.probe_from_plane.inverse())
        return self.field.read(composed(composed(fixed, self.mr_from_plane), mount))

    def rng(self, stream: str) -> np.random.Generator:
        return child_rng(self.drawn.seed, f"second world {stream}")


def operating_room(
    heart: RestingHeart, seconds: float, drawn: Drawn, breath: BreathKind | None = None
) -> OperatingRoom:
    """Draw the source of all streams of `seconds`, with breathing of a kind or without."""
    spec = BreathSpec() if breath is None else _breath_spec(breath, drawn)
    breaths = draw_breaths(spec, seconds, child_rng(drawn.seed, "second world breaths"))
    fields = tissue_fields(heart, drawn)
    changed, rms_mm = changed_heart(heart, fields.reference, drawn)
    beats = _beats(seconds, drawn, breaths if spec.moves else None)
    delays = drawn["rhythm.gate_noise_s"] * child_rng(drawn.seed, "second world gates").standard_normal(
        len(beats.r_peaks_s)
    )
    probe = drawn_probe(drawn)
    mr_from_plane, window = sweep(heart, fields.reference, drawn)
    mr_from_tracker = true_pose(heart, drawn)
    probe_from_plane = _mount(drawn)
    sensor = composed(mr_from_plane, constant_path(probe_from_plane.inverse()))
    tracked = composed(constant_path(mr_from_tracker.inverse()), sensor)
    stands = tracked(np.linspace(0.0, seconds, 200))[1]
    box = mr_from_tracker.inverse().apply_array(heart.ed_vertices_mm)
    return OperatingRoom(
        heart=heart,
        fields=fields,
        changed=changed,
        surface=MovingSurface.of(changed),
        changed_rms_mm=rms_mm,
        beats=beats,
        clock=NoisyClock(beats.r_peaks_s, delays, cycle_law(heart, drawn)),
        probe=probe,
        mr_from_plane=mr_from_plane,
        window=window,
        mr_from_tracker=mr_from_tracker,
        probe_from_plane=probe_from_plane,
        calibrated=_calibrated(probe_from_plane, probe, drawn),
        tip=_tip(drawn),
        lag_s=drawn["calibration.lag_s"],
        field=distorted_field(box_of(np.concatenate([stands, box])), drawn),
        drawn=drawn,
        breathing=breathing_of(
            spec, breaths, heart.box_mm.mean(axis=0), child_rng(drawn.seed, "second world breathing")
        ),
    )


def _breath_spec(kind: BreathKind, drawn: Drawn) -> BreathSpec:
    excursion = drawn[f"breathing.{kind}_mm"]
    return BreathSpec(
        kind,
        excursion,
        drawn["breathing.per_minute"],
        drawn["breathing.tilt_deg_per_cm"] * excursion / 10.0,
        drawn["breathing.stretch_mm_per_cm"] * excursion / 10.0,
        drawn["breathing.nonrigid_mm_per_cm"] * excursion / 10.0,
        drawn["breathing.lagging"],
        drawn["breathing.backlash"],
    )


def cycle_law(heart: RestingHeart, drawn: Drawn) -> CycleLaw:
    """Build the law by which this heart's cycle changes with its rate."""
    return CycleLaw(
        heart.rr_s,
        heart.es_fraction,
        drawn["rhythm.filling_share"],
        drawn["rhythm.systole_power"],
        drawn["rhythm.filling_power"],
    )


def image_map(probe_from_plane: Rigid, probe: SectorProbe) -> ImageMap:
    """Compute probe_from_image of a mounting."""
    plane_from_image = probe.plane_from_image
    return ImageMap(probe_from_plane @ plane_from_image.rigid, plane_from_image.scale_mm_per_px)


def constant_path(pose: Rigid) -> PosePath:
    """Build the path of a constant pose."""

    def path(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        count = len(np.asarray(t_s))
        return np.repeat(pose.rotation[None], count, axis=0), np.repeat(
            pose.translation_mm[None], count, axis=0
        )

    return path


def _beats(seconds: float, drawn: Drawn, breaths: Breaths | None) -> Beats:
    spec = RhythmSpec(
        rate_bpm=((0.0, drawn["rhythm.rate_bpm"]),),
        respiratory=drawn["rhythm.respiratory"],
        mayer=drawn["rhythm.mayer"],
        jitter=drawn["rhythm.jitter"],
        ectopic_share=drawn["rhythm.ectopic_share"],
    )
    volume = None if breaths is None else breaths.volume_at
    return beat_series(spec, -3.0, seconds + 3.0, child_rng(drawn.seed, "second world rhythm"), volume)


def true_pose(heart: RestingHeart, drawn: Drawn) -> Rigid:
    """Draw mr_from_tracker: any rotation, the heart at the drawn distance."""
    rng = child_rng(drawn.seed, "second world planted")
    turn = Rotation.random(rng=rng).as_matrix()
    direction = rng.standard_normal(3)
    place = drawn["tracker.heart_distance_mm"] * direction / np.linalg.norm(direction)
    center = heart.box_mm.mean(axis=0)
    return Rigid("tracker", "mr", turn, place - turn @ center).inverse()


def _mount(drawn: Drawn) -> Rigid:
    rng = child_rng(drawn.seed, "second world mount")
    return Rigid("probe", "plane", Rotation.random(rng=rng).as_matrix(), rng.uniform(-35.0, 35.0, 3))


def _calibrated(probe_from_plane: Rigid, probe: SectorProbe, drawn: Drawn) -> ImageMap:
    """Compute the calibration with its error."""
    return image_map(miscalibrated(probe_from_plane, probe.depth_mm, drawn), probe)


def miscalibrated(probe_from_plane: Rigid, depth_mm: float, drawn: Drawn) -> Rigid:
    """Add the drawn error at the middle of the image to a mounting."""
    rng = child_rng(drawn.seed, "second world calibration")
    turn_rad, shift_mm = random_displacement(
        rng, shift_mm=drawn["calibration.shift_mm"], turn_deg=drawn["calibration.turn_deg"]
    )
    middle = probe_from_plane.apply_array(np.array([[0.0, 0.5 * depth_mm, 0.0]]))[0]
    return probe_from_plane.perturbed_left(turn_rad, shift_mm, middle)


def _tip(drawn: Drawn) -> Points:
    rng = child_rng(drawn.seed, "second world tool")
    return Points("tool", rng.uniform((-15.0, -15.0, 0.8 * TOOL_MM), (15.0, 15.0, 1.2 * TOOL_MM))[None])
