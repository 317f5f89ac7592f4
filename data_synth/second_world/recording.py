"""Intervention of the second world: all recordings, its truth, and the floor of registration errors."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from data_synth.breathing.breaths import BreathKind, BreathSpec
from data_synth.breathing.motion import seen_at_rest
from data_synth.breathing.recorded import recorded_breathing
from data_synth.heart.heart_spec import HeartKind, HeartSpec
from data_synth.heart.motion import MotionPreset
from data_synth.mr.examination import EXAMS, Examination, ExamName
from data_synth.operator.contact import tool_truth
from data_synth.operator.contact_sites import contact_sites
from data_synth.operator.hand import perpendicular
from data_synth.operator.pose_path import composed
from data_synth.operator.tool_path import ToolSpec, tip_path, tool_path
from data_synth.phantoms.nwire import NWireSpec, nwire_recording
from data_synth.phantoms.pivot import pivot_recording
from data_synth.phantoms.watertank import WaterTankSpec, watertank_recording
from data_synth.scenario.displacement import random_displacement
from data_synth.signals.ecg import EcgSpec, synthetic_ecg
from data_synth.signals.tracker import TrackerSpec, sampling_times, tracked
from dvf_ig.core import (
    CycleTiming,
    FloatArray,
    InvalidInputError,
    Landmarks,
    LatencyRecording,
    NWireRecording,
    Points,
    PoseStream,
    Preop,
    Rigid,
    Scenario,
    ScenarioTruth,
    Signal,
    SurfaceSeries,
    ToolTruth,
    TrackedSequence,
)

from .cine import cine, examine, segmented
from .drawn import Drawn, Quality
from .echo_images import echo_images
from .floor import RigidFloor, rigid_floor
from .measured_poses import probe_sensor, tool_sensor
from .operating_room import TOOL_MM, OperatingRoom, constant_path, cycle_law, operating_room
from .probes import probe_kind
from .resting_heart import four_chamber_heart
from .sweeps import sweep_way

TRUTH_PHASES = 40
TICK_HZ = 1000.0
_LINE_S_PER_MM = 1.4e-6
"""Time that a scan line takes for each mm of depth: there, back, and a pause."""
_ANTERIOR = np.array([0.4, -0.9, -0.15])

Report = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class SecondWorldSpec:
    """Specification of an intervention; the same values give bit-identical recordings.

    Attributes:
        seed: seed of every random choice, a non-negative integer.
        quality: part of the graded ranges that is drawn.
        motion: motion of the phantom's heart.
        seconds: length of the live part.
        us_rate_hz: ultrasound frame rate.
        heart: kind of heart; "varied" is drawn from the population.
        breathing: kind of breathing; None: none.
        exam: its MR as an examination (see `mr.examination`); None: transverse slices, labels of every phase.
    """

    seed: int = 5001
    quality: Quality = "calm"
    motion: MotionPreset = "paper5mm"
    seconds: float = 60.0
    us_rate_hz: float = 12.0
    heart: HeartKind = "varied"
    breathing: BreathKind | None = None
    exam: ExamName | None = None

    def __post_init__(self) -> None:
        Drawn(self.seed, self.quality)
        HeartSpec(self.heart)
        BreathSpec(self.breathing or "ventilated")
        if self.motion not in get_args(MotionPreset):
            raise InvalidInputError(
                f"there is no motion '{self.motion}'; choose from {', '.join(get_args(MotionPreset))}"
            )
        if self.exam is not None and self.exam not in EXAMS:
            raise InvalidInputError(f"there is no examination '{self.exam}'; choose from {', '.join(EXAMS)}")
        if not 5.0 <= self.seconds <= 3600.0 or not 6.0 <= self.us_rate_hz <= 60.0:
            raise InvalidInputError(
                f"{self.seconds:g} s at {self.us_rate_hz:g} images/s; needed 5 to 3600 s and 6 to 60 images/s"
            )


@dataclass(frozen=True, slots=True, eq=False)
class SecondWorldRecording:
    """Scenario with the truth of its heart beyond the scenario's own.

    Attributes:
        scenario: the scenario.
        floor: error that no rigid registration can remove.
        probe, sweep: kind of probe, and manner of its sweep.
        room: the heart before and under the probe, and all drawn values.
        examined: its MR as a hospital's examination, with its truth; None: transverse slices.
    """

    scenario: Scenario
    floor: RigidFloor
    probe: str
    sweep: str
    room: OperatingRoom
    examined: Examination | None = None

    @property
    def drawn(self) -> Drawn:
        """Values drawn from the table of ranges."""
        return self.room.drawn


def second_world_recording(
    spec: SecondWorldSpec, progress: Report | None = None, phases: int | None = None
) -> SecondWorldRecording:
    """Record one intervention.

    Args:
        progress: called with the fraction done.
        phases: of an examination, instead of the number that is drawn, to save time.
    """
    report: Report = progress or (lambda share: None)
    drawn = Drawn(spec.seed, spec.quality)
    resting = four_chamber_heart(spec.motion, spec.seed, spec.heart)
    room = operating_room(resting, spec.seconds, drawn, spec.breathing)
    report(0.3)
    examined = None if spec.exam is None else examine(resting, room.fields, spec.exam, drawn, phases)
    if examined is None:
        preop = cine(resting, room.fields, cycle_law(resting, drawn), drawn)
    else:
        preop = segmented(examined, resting, room.fields, drawn)
    report(0.5)
    tool, contact = _tool(room, spec.seconds)
    report(0.55)
    taken_s = _image_times(room, spec)
    ultrasound = _ultrasound(room, spec, taken_s, lambda share: report(0.55 + 0.44 * share))
    tip = pivot_recording(room.tip, _steady_sensor(20.0), room.rng("pivot"))
    landmarks = resting.landmarks
    scenario = Scenario(
        name=f"second world, {resting.name}, {spec.motion}, {spec.quality}, seed {spec.seed}",
        preset=f"second-world {spec.quality}",
        preop=preop,
        ecg=_ecg(room, spec.seconds),
        ultrasound=ultrasound,
        fan=room.probe.fan,
        probe=_nwire(room),
        latency=_watertank(room),
        tool=tool,
        tip=tip,
        start=_start(room),
        landmarks_mr=landmarks,
        landmarks_tracker=_touched(room, landmarks),
        seed=spec.seed,
        truth=_truth(room, preop, contact, spec.seconds),
        **_breathing_recorded(room, spec.seconds),
    )
    report(1.0)
    return SecondWorldRecording(
        scenario, rigid_floor(room, taken_s), probe_kind(drawn), sweep_way(drawn), room, examined
    )


def _tool(room: OperatingRoom, seconds: float) -> tuple[PoseStream, ToolTruth]:
    """Simulate tracker_from_tool as measured, and the true contact of its tip at every millisecond."""
    rng, spec = room.rng("tool path"), ToolSpec(free_s=10.0, length_mm=TOOL_MM)
    access = perpendicular(room.window, _ANTERIOR / np.linalg.norm(_ANTERIOR))
    sites = contact_sites(room.surface, access, spec.sites, rng)
    tip = tip_path(room.surface, room.clock, sites, seconds, spec, rng)
    ticks_s = np.arange(round(seconds * TICK_HZ)) / TICK_HZ
    contact = tool_truth(room.surface, room.clock, ticks_s, tip(ticks_s))
    mr_from_tool = tool_path(tip, access, room.tip, rng)
    if room.breathing is not None:
        contact = room.breathing.carried_contact(contact)
        mr_from_tool = room.breathing.carried(mr_from_tool, room.tip.xyz_mm[0])
    true_pose = composed(constant_path(room.mr_from_tracker.inverse()), mr_from_tool)
    sensor = tool_sensor(room.drawn)
    true_s, stamp_s = sampling_times(sensor, 0.0, seconds, rng)
    read = room.field.read(true_pose)
    return tracked(read, "tracker", "tool", true_s, stamp_s, sensor, rng), contact


def _image_times(room: OperatingRoom, spec: SecondWorldSpec) -> FloatArray:
    """Draw (n,) true times of the images."""
    step_s = 1.0 / spec.us_rate_hz
    taken_s = np.arange(0.1, spec.seconds - 0.1, step_s)
    jitter = room.drawn["calibration.video_jitter_s"] * room.rng("video").standard_normal(len(taken_s))
    taken_s += np.clip(jitter, -0.2 * step_s, 0.2 * step_s)
    # stamps are written with six digits, to which the true times are rounded
    return np.asarray(np.round(taken_s - room.lag_s, 6) + room.lag_s)


def _ultrasound(
    room: OperatingRoom, spec: SecondWorldSpec, taken_s: FloatArray, report: Report
) -> TrackedSequence:
    """Simulate images stamped on the video clock, each with the pose that the tracker gave at its stamp."""
    view, hearts = seen_at_rest(room.breathing, room.mr_from_plane, room.changed, taken_s)
    poses = [Rigid("mr", "plane", r, t) for r, t in zip(*view(taken_s), strict=True)]
    line_s = _LINE_S_PER_MM * room.probe.depth_mm
    within = (np.arange(room.probe.lines) - 0.5 * (room.probe.lines - 1)) * line_s
    phases = room.clock.model_phase(taken_s[:, None] + within)
    images = echo_images(hearts, room.probe, poses, phases, taken_s, room.drawn, report)
    stamp_s = np.round(taken_s - room.lag_s, 6)
    sensor = probe_sensor(room.drawn, spec.us_rate_hz)
    stream = tracked(
        room.tracker_from_probe, "tracker", "probe", stamp_s, stamp_s, sensor, room.rng("probe tracker")
    )
    return TrackedSequence(stamp_s, images, np.ones(len(stamp_s), dtype=np.bool_), {stream.name: stream})


def _ecg(room: OperatingRoom, seconds: float) -> Signal:
    drawn = room.drawn
    spec = EcgSpec(emg_mv=drawn["rhythm.ecg_noise_mv"], baseline_mv=drawn["rhythm.ecg_baseline_mv"])
    volume = None if room.breathing is None else room.breathing.breaths.volume_at
    return synthetic_ecg(room.beats, seconds, spec, room.rng("ecg"), volume)


def _breathing_recorded(room: OperatingRoom, seconds: float) -> dict[str, Any]:
    """Record the breath as fields of a scenario."""
    if room.breathing is None:
        return {}
    path = constant_path(room.mr_from_tracker)
    return recorded_breathing(room.breathing, path, seconds, room.rng("breathing recorded"))


def _steady_sensor(rate_hz: float) -> TrackerSpec:
    """Return the sensor's noise during a calibration, in the undistorted middle of the field."""
    return TrackerSpec(rate_hz=rate_hz, position_mm=0.15, rotation_deg=0.08)


def _nwire(room: OperatingRoom) -> NWireRecording:
    probe = room.probe
    deep = probe.depth_mm
    spec = NWireSpec(
        frames=100,
        point_noise_mm=room.drawn["calibration.point_noise_mm"],
        top_depth_mm=(0.4 * deep, 0.85 * deep - 20.0),
        lateral_mm=0.25 * deep * float(np.tan(probe.half_angle_rad)),
    )
    size = (probe.columns, probe.rows)
    return nwire_recording(room.calibrated, probe.fan, size, _steady_sensor(12.0), spec, room.rng("n-wire"))


def _watertank(room: OperatingRoom) -> LatencyRecording:
    drawn = room.drawn
    spec = WaterTankSpec(
        depth_mm=0.6 * room.probe.depth_mm,
        row_noise_mm=drawn["calibration.row_noise_mm"],
        video_jitter_s=drawn["calibration.video_jitter_s"],
    )
    lag_s = room.lag_s + drawn["calibration.lag_error_s"]
    return watertank_recording(
        room.calibrated, room.probe.fan, lag_s, _steady_sensor(50.0), spec, room.rng("water tank")
    )


def _start(room: OperatingRoom) -> Rigid:
    """Turn the true pose about the heart's centre and move it by the drawn amounts."""
    turn_rad, shift_mm = random_displacement(
        room.rng("start"), shift_mm=room.drawn["start.shift_mm"], turn_deg=room.drawn["start.turn_deg"]
    )
    return room.mr_from_tracker.perturbed_left(turn_rad, shift_mm, room.heart.box_mm.mean(axis=0))


def _touched(room: OperatingRoom, landmarks: Landmarks) -> Landmarks:
    exact = room.mr_from_tracker.inverse().apply(landmarks.points).xyz_mm
    error = room.rng("landmarks").standard_normal(exact.shape) * room.drawn["start.landmark_mm"]
    return Landmarks(landmarks.names, Points("tracker", exact + error / np.sqrt(3.0)))


def _truth(room: OperatingRoom, preop: Preop, contact: ToolTruth, seconds: float) -> ScenarioTruth:
    moving = SurfaceSeries(
        preop.surface,
        "mr",
        np.stack([room.surface.at(i / TRUTH_PHASES) for i in range(TRUTH_PHASES)]),
        room.surface.triangles,
        CycleTiming(np.arange(TRUTH_PHASES) / TRUTH_PHASES, room.heart.rr_s),
        preop.patient_id,
    )
    peaks = room.beats.r_peaks_s
    return ScenarioTruth(
        mr_from_tracker=((0.0, room.mr_from_tracker),),
        probe_from_image=room.probe_from_image,
        tip=room.tip,
        lag_s=room.lag_s,
        r_peaks_s=peaks[(peaks >= 0.0) & (peaks < seconds)],
        targets=room.heart.targets,
        surface=moving,
        tool=contact,
        mismatch_mm=room.changed_rms_mm,
        respiration_mm=0.0 if room.breathing is None else room.breathing.spec.excursion_mm,
        breathing=None if room.breathing is None else room.breathing.truth(room.heart.targets, seconds),
    )
