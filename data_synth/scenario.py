"""One synthetic intervention: a beating heart, what was known of it before, and every recorded stream."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import (
    CycleTiming,
    FloatArray,
    InvalidInputError,
    NWireRecording,
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

from .anatomy import BeatingAnatomy, phantom_anatomy
from .contact import MovingSurface, tool_truth
from .contact_sites import contact_sites
from .ecg import synthetic_ecg
from .hand import perpendicular, reframed
from .heart_clock import HeartClock
from .nwire import nwire_recording
from .pivot import pivot_recording
from .planting import Planted, coarse_start, plant, touched_landmarks
from .presets import ScenarioSpec
from .probe_path import (
    HeartOutline,
    ReplayedPath,
    acoustic_window,
    central_view,
    sweeping_path,
)
from .rhythm import beat_series
from .seeds import child_rng, child_seed
from .surfaces import surface_anatomy
from .tissue import Tissue
from .tool_path import tip_path, tool_path
from .tracker import PosePath, sampling_times, tracked
from .ultrasound import simulate_sequence
from .ultrasound_probe import SectorProbe
from .watertank import watertank_recording

TICK_HZ = 1000.0
TRUTH_PHASES = 40
LINE_OVERHEAD = 1.1
SOUND_MM_S = 1.54e6
ANTERIOR_LEFT = np.array([0.52, -0.83, -0.20])
"""Preferred acoustic window in LPS: from the left front, slightly below."""

Report = Callable[[float], None]


@dataclass(frozen=True, slots=True, eq=False)
class _World:
    """What every stream of one scenario is made from."""

    spec: ScenarioSpec
    anatomy: BeatingAnatomy
    clock: HeartClock
    surface: MovingSurface
    outline: HeartOutline
    window: FloatArray
    probe: SectorProbe
    planted: Planted

    def rng(self, stream: str) -> np.random.Generator:
        return child_rng(self.spec.seed, stream)


def phantom_scenario(spec: ScenarioSpec, progress: Report | None = None) -> Scenario:
    """A scenario on the four-chamber phantom.

    Args:
        spec: what to make.
        progress: called with the fraction done.
    """
    seed = child_seed(spec.seed, "anatomy")
    anatomy = phantom_anatomy(motion=spec.motion, mismatch_mm=spec.mismatch, seed=seed)
    beats = beat_series(spec.options.rhythm, -3.0, spec.seconds + 3.0, child_rng(spec.seed, "rhythm"))
    ecg = synthetic_ecg(beats, spec.seconds, spec.options.ecg, child_rng(spec.seed, "ecg"))
    world = _world(spec, anatomy, beats.r_peaks_s, progress)
    sweep = sweeping_path(world.outline, world.window, spec.options.sweep, world.rng("probe path"))
    name = f"four-chamber phantom, {spec.motion}, {spec.preset}, seed {spec.seed}"
    return _assembled(name, world, ecg, sweep, with_start=True, progress=progress)


def surface_scenario(
    spec: ScenarioSpec,
    surfaces: Mapping[str, SurfaceSeries],
    ecg: Signal,
    r_peaks_s: FloatArray,
    probe_path: ReplayedPath,
    progress: Report | None = None,
) -> Scenario:
    """A scenario on real surfaces, with a real ECG and a real probe path; only the ultrasound is simulated.

    Args:
        spec: `motion` is not used: the surfaces carry their own.
        surfaces: corresponding series by name; "EPICARDIAL" is required.
        ecg: from time 0 on, at least `spec.seconds` long.
        r_peaks_s: true beats on the ECG's clock; the heart beats at these.
        probe_path: recorded hand motion.
        progress: called with the fraction done.
    Raises:
        InvalidInputError: ECG too short, or fewer than two beats.
    """
    stop_s = ecg.start_s + len(ecg) / ecg.rate_hz
    if ecg.start_s > 0 or stop_s < spec.seconds - 1e-6:
        raise InvalidInputError(
            f"the ECG runs from {ecg.start_s:g} to {stop_s:g} s; needed 0 to {spec.seconds:g} s: "
            "take a longer record or fewer seconds"
        )
    seed = child_seed(spec.seed, "anatomy")
    anatomy = surface_anatomy(surfaces, mismatch_mm=spec.mismatch, seed=seed)
    world = _world(spec, anatomy, np.asarray(r_peaks_s, dtype=np.float64), progress)
    view = central_view(world.outline, world.window)
    mr_from_mean_probe = view @ world.planted.probe_from_plane.inverse()
    sweep = reframed(probe_path, mr_from_mean_probe, world.planted.probe_from_plane)
    name = f"real surfaces and ECG, {spec.preset}, seed {spec.seed}"
    return _assembled(name, world, ecg.between(0.0, spec.seconds), sweep, with_start=False, progress=progress)


def _world(
    spec: ScenarioSpec, anatomy: BeatingAnatomy, r_peaks_s: FloatArray, progress: Report | None
) -> _World:
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
    probe = SectorProbe()
    rng = child_rng(spec.seed, "planting")
    center = anatomy.box_mm.mean(axis=0)
    planted = plant(center, probe.plane_from_image, spec.options.tool.length_mm, rng)
    clock = HeartClock(r_peaks_s, anatomy.rr_s, anatomy.es_fraction)
    _tell(progress, 0.12)
    return _World(spec, anatomy, clock, surface, outline, window, probe, planted)


def _assembled(
    name: str, world: _World, ecg: Signal, sweep: PosePath, *, with_start: bool, progress: Report | None
) -> Scenario:
    spec, planted, anatomy = world.spec, world.planted, world.anatomy
    preop = anatomy.preop(world.rng("preop"))
    _tell(progress, 0.3)
    ultrasound = _ultrasound(world, sweep, lambda done: _tell(progress, 0.3 + 0.6 * done))
    tool, contact = _tool(world)
    _tell(progress, 0.97)
    options, center = spec.options, anatomy.box_mm.mean(axis=0)
    landmarks = anatomy.landmarks()
    start = coarse_start(
        planted.mr_from_tracker, center, options.start_mm, options.start_deg, world.rng("start")
    )
    scenario = Scenario(
        name=name,
        preset=spec.preset,
        preop=preop,
        ecg=ecg,
        ultrasound=ultrasound,
        fan=world.probe.fan,
        tool=tool,
        pivot=pivot_recording(planted.tip_in_tool, options.pivot_tracker, world.rng("pivot")),
        nwire=_nwire(world),
        latency=watertank_recording(
            planted.probe_from_image,
            world.probe.fan,
            planted.lag_s,
            options.watertank_tracker,
            options.watertank,
            world.rng("water tank"),
        ),
        start=start if with_start else None,
        landmarks_mr=landmarks,
        landmarks_tracker=touched_landmarks(landmarks, planted.mr_from_tracker, world.rng("landmarks")),
        seed=spec.seed,
        truth=_truth(world, preop, contact),
    )
    _tell(progress, 1.0)
    return scenario


def _ultrasound(world: _World, mr_from_plane: PosePath, report: Report) -> TrackedSequence:
    """Images stamped on the video clock, each with tracker_from_probe as tracked at its stamp.

    An image taken at tracker time t carries the stamp t − lag, and the recorder looks up the tracker at that
    number: the pose beside an image is the one from `lag` earlier, as an uncorrected recorder gives it.
    """
    spec, planted, probe = world.spec, world.planted, world.probe
    rng = world.rng("ultrasound")
    step_s = 1.0 / spec.us_rate_hz
    taken_s = np.arange(0.1, spec.seconds - 0.1, step_s)
    jitter = spec.options.video_jitter_s * rng.standard_normal(len(taken_s))
    taken_s = taken_s + np.clip(jitter, -0.1 * step_s, 0.1 * step_s)
    stamp_s = np.round(taken_s - planted.lag_s, 6)
    taken_s = stamp_s + planted.lag_s
    rotations, apexes = mr_from_plane(taken_s)
    poses = [Rigid("mr", "plane", r, t) for r, t in zip(rotations, apexes, strict=True)]
    line_s = LINE_OVERHEAD * 2.0 * probe.depth_mm / SOUND_MM_S
    offsets_s = (np.arange(probe.lines) - 0.5 * (probe.lines - 1)) * line_s
    phases = world.clock.model_phase(taken_s[:, None] + offsets_s)
    images = simulate_sequence(
        world.anatomy,
        probe,
        poses,
        phases,
        seed=child_seed(spec.seed, "speckle"),
        progress=lambda done, count: report(done / count),
    )
    tracker_from_probe = reframed(
        mr_from_plane, planted.mr_from_tracker.inverse(), planted.probe_from_plane.inverse()
    )
    stream = tracked(
        tracker_from_probe, "tracker", "probe", stamp_s, stamp_s, spec.options.probe_tracker,
        world.rng("probe tracker"),
    )  # fmt: skip
    return TrackedSequence(stamp_s, images, np.ones(len(stamp_s), dtype=np.bool_), {stream.name: stream})


def _tool(world: _World) -> tuple[PoseStream, ToolTruth]:
    """The tracked tool, and what its tip truly meets at every millisecond."""
    spec, planted = world.spec, world.planted
    rng = world.rng("tool path")
    access = perpendicular(world.window, ANTERIOR_LEFT)
    options = spec.options.tool
    sites = contact_sites(world.surface, access, options.sites, rng)
    tip = tip_path(world.surface, world.clock, sites, spec.seconds, options, rng)
    mr_from_tool = tool_path(tip, access, planted.tip_in_tool, rng)
    tracker_rng = world.rng("tool tracker")
    true_s, stamp_s = sampling_times(spec.options.tool_tracker, 0.0, spec.seconds, tracker_rng)
    identity = Rigid.identity("tool", "tool")
    path = reframed(mr_from_tool, planted.mr_from_tracker.inverse(), identity)
    stream = tracked(path, "tracker", "tool", true_s, stamp_s, spec.options.tool_tracker, tracker_rng)
    ticks_s = np.arange(round(spec.seconds * TICK_HZ)) / TICK_HZ
    return stream, tool_truth(world.surface, world.clock, ticks_s, tip(ticks_s))


def _nwire(world: _World) -> NWireRecording:
    options = world.spec.options
    return nwire_recording(
        world.planted.probe_from_image,
        world.probe.fan,
        (world.probe.columns, world.probe.rows),
        options.probe_tracker,
        options.nwire,
        world.rng("n-wire"),
    )


def _truth(world: _World, preop: Preop, contact: ToolTruth) -> ScenarioTruth:
    """Everything planted, with the true surface at TRUTH_PHASES phases."""
    anatomy, planted, surface = world.anatomy, world.planted, world.surface
    moving = SurfaceSeries(
        preop.surface,
        "mr",
        np.stack([surface.at(i / TRUTH_PHASES) for i in range(TRUTH_PHASES)]),
        surface.triangles,
        CycleTiming(np.arange(TRUTH_PHASES) / TRUTH_PHASES, anatomy.rr_s),
        preop.patient_id,
    )
    peaks = world.clock.r_peaks_s
    return ScenarioTruth(
        mr_from_tracker=((0.0, planted.mr_from_tracker),),
        probe_from_image=planted.probe_from_image,
        tip=planted.tip_in_tool,
        lag_s=planted.lag_s,
        r_peaks_s=peaks[(peaks >= 0.0) & (peaks < world.spec.seconds)],
        targets=anatomy.targets(),
        surface=moving,
        tool=contact,
        mismatch_mm=world.spec.mismatch,
    )


def _tell(progress: Report | None, done: float) -> None:
    if progress is not None:
        progress(done)
