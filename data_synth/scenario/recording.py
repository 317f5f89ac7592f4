"""Synthetic intervention: a beating heart, its pre-operative data, and all recorded streams."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from data_synth.breathing.breaths import Breaths, draw_breaths
from data_synth.breathing.recorded import recorded_breathing
from data_synth.cine_heart.anatomy import CineHeart, cine_anatomy
from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.heart.heart_spec import HeartKind, HeartSpec
from data_synth.heart.motion import UNCHANGED_MOTION, MotionPreset
from data_synth.mr.cine import cine_preop
from data_synth.mr.examination import Examination, ExamName, examination
from data_synth.operator.hand import reframed
from data_synth.operator.probe_path import ReplayedPath, central_view, sweeping_path
from data_synth.operator.tool_in_view import looking_at
from data_synth.phantoms.nwire import nwire_recording
from data_synth.phantoms.pivot import pivot_recording
from data_synth.phantoms.watertank import watertank_recording
from data_synth.seeds import child_rng, child_seed
from data_synth.signals.ecg import synthetic_ecg
from data_synth.signals.rhythm import beat_series
from data_synth.signals.tracker import PosePath
from data_synth.surfaces.anatomy import surface_anatomy
from dvf_ig.core import (
    CycleTiming,
    FloatArray,
    InvalidInputError,
    NWireRecording,
    Preop,
    Scenario,
    ScenarioTruth,
    Signal,
    SurfaceSeries,
    ToolTruth,
)

from .ground_truth import coarse_start, touched_landmarks, touched_surface
from .live import tool_task, tracked_tool, tracked_ultrasound
from .presets import ScenarioSpec
from .world import World, make_world

TRUTH_PHASES = 40

Report = Callable[[float], None]


@dataclass(frozen=True, slots=True, eq=False)
class ImagedHeart:
    """Heart of a phantom with its pre-operative images, which all recordings of one heart share.

    Attributes:
        spec: specification it was made for; recordings of it agree in kind of heart, motion, and seeds of
            both.
    """

    spec: ScenarioSpec
    anatomy: PhantomAnatomy
    preop: Preop

    def of(self, spec: ScenarioSpec) -> PhantomAnatomy:
        """Return the heart with the changes since the MR of another recording.

        Raises:
            InvalidInputError: a recording of another heart.
        """
        if _heart_of(spec) != _heart_of(self.spec):
            raise InvalidInputError(
                "the recording specifies another heart than the imaged one; use its kind, motion and seeds"
            )
        seed = child_seed(spec.seeds.mismatch, "anatomy")
        return self.anatomy.changed(spec.mismatch, seed, spec.options.surgery, spec.motion_change)


def imaged_heart(spec: ScenarioSpec, *, phases: int | None = None) -> ImagedHeart:
    """Build the heart of `phantom_scenario` with its 4-D MR.

    Args:
        phases: of an examination, instead of the number that is drawn, to save time.
    """
    anatomy = scenario_heart(spec)
    return ImagedHeart(spec, anatomy, _imaged(anatomy, spec, phases))


def _imaged(anatomy: PhantomAnatomy, spec: ScenarioSpec, phases: int | None = None) -> Preop:
    """Image a heart; the noise comes from the anatomy's seed, so that all recordings of it agree."""
    exam = scenario_examination(spec, phases)
    if exam is not None:
        return exam.preop(f"phantom-{anatomy.seeds.anatomy}")
    return cine_preop(anatomy, child_rng(spec.seeds.anatomy, "preop"))


def scenario_examination(spec: ScenarioSpec, phases: int | None = None) -> Examination | None:
    """Examine the heart of `phantom_scenario`; None if its MR is isotropic."""
    if spec.exam is None:
        return None
    return _examined(spec.heart.kind, spec.motion, spec.seeds.anatomy, spec.seeds.motion, spec.exam, phases)


@lru_cache(maxsize=1)
def _examined(
    kind: HeartKind,
    motion: MotionPreset,
    anatomy_seed: int,
    motion_seed: int,
    exam: ExamName,
    phases: int | None,
) -> Examination:
    """Examine a heart once for its pre-operative data and their truth; mismatch and speckle play no part."""
    heart = HeartSpec(kind, anatomy_seed, motion_seed)
    anatomy = scenario_heart(ScenarioSpec(motion=motion, heart=heart, mismatch_mm=0.0))
    return examination(anatomy, anatomy.reference, exam, child_rng(anatomy_seed, "preop"), phases)


def phantom_scenario(
    spec: ScenarioSpec, progress: Report | None = None, imaged: ImagedHeart | None = None
) -> Scenario:
    """Record a scenario on the four-chamber phantom.

    Args:
        spec: specification.
        progress: called with the fraction done.
        imaged: its heart from another recording of it, which saves computing it.
    Raises:
        InvalidInputError: `imaged` is another heart.
    """
    anatomy = scenario_heart(spec) if imaged is None else imaged.of(spec)
    breaths, peaks_s, ecg = _signals(spec)
    world = make_world(spec, anatomy, peaks_s, breaths)
    _report_progress(progress, 0.12)
    sweep = sweeping_path(
        world.outline, world.window, spec.options.sweep, world.rng("probe path"), world.standoff_mm
    )
    heart = "four-chamber phantom" if spec.heart.kind == "standard" else f"{anatomy.kind} heart"
    name = f"{heart}, {spec.motion}, {spec.preset}, seed {spec.seed}"
    preop = _imaged(anatomy, spec) if imaged is None else imaged.preop
    return _assembled(name, world, preop, ecg, sweep, with_start=True, progress=progress)


def _heart_of(spec: ScenarioSpec) -> tuple[object, ...]:
    return spec.heart.kind, spec.motion, spec.seeds.anatomy, spec.seeds.motion, spec.exam


def scenario_heart(spec: ScenarioSpec) -> PhantomAnatomy:
    """Build the heart of `phantom_scenario`."""
    seeds = (spec.seeds.anatomy, spec.seeds.motion, spec.seeds.mismatch)
    children = (child_seed(seed, "anatomy") for seed in seeds)
    heart = HeartSpec(spec.heart.kind, *children)
    return phantom_anatomy(
        motion=spec.motion,
        mismatch_mm=spec.mismatch,
        seed=child_seed(spec.seed, "anatomy"),
        heart=heart,
        surgery=spec.options.surgery,
        motion_change=spec.motion_change,
    )


def preoperative_surface(spec: ScenarioSpec, preop: Preop) -> SurfaceSeries:
    """Sample the surface of the heart of `phantom_scenario` in the phases of its MR; vertices correspond.

    Args:
        preop: of that scenario, with its MR.
    Raises:
        InvalidInputError: no MR.
    """
    if preop.mr is None:
        raise InvalidInputError("the pre-operative data have no MR, whose phases the surface needs")
    heart, timing = HeartSpec(spec.heart.kind, spec.seeds.anatomy, spec.seeds.motion), preop.mr.timing
    anatomy = scenario_heart(ScenarioSpec(motion=spec.motion, heart=heart, mismatch_mm=0.0))
    vertices = np.stack([anatomy.surface_vertices(phase) for phase in timing.fractions.tolist()])
    return SurfaceSeries(preop.surface, "mr", vertices, anatomy.surface_triangles, timing, preop.patient_id)


def surface_scenario(
    spec: ScenarioSpec,
    surfaces: Mapping[str, SurfaceSeries],
    ecg: Signal,
    r_peaks_s: FloatArray,
    probe_path: ReplayedPath,
    progress: Report | None = None,
) -> Scenario:
    """Record a scenario on real surfaces, ECG and probe path; only the ultrasound is simulated.

    Args:
        spec: `motion` is not used: the surfaces have their own.
        surfaces: corresponding series by name; "EPICARDIAL" is required.
        ecg: from time 0 on, at least `spec.seconds` long.
        r_peaks_s: true beats on the ECG's clock; the heart beats at these.
        probe_path: recorded hand motion.
        progress: called with the fraction done.
    Raises:
        InvalidInputError: ECG too short, fewer than two beats, or a preset of another motion.
    """
    _keeps_its_motion(spec)
    stop_s = ecg.start_s + len(ecg) / ecg.rate_hz
    if ecg.start_s > 0 or stop_s < spec.seconds - 1e-6:
        raise InvalidInputError(
            f"the ECG runs from {ecg.start_s:g} to {stop_s:g} s; needed 0 to {spec.seconds:g} s: "
            "take a longer record or fewer seconds"
        )
    seed = child_seed(spec.seeds.mismatch, "anatomy")
    anatomy = surface_anatomy(surfaces, mismatch_mm=spec.mismatch, seed=seed, surgery=spec.options.surgery)
    world = make_world(spec, anatomy, np.asarray(r_peaks_s, dtype=np.float64), _breaths(spec))
    _report_progress(progress, 0.12)
    view = central_view(world.outline, world.window, world.central_standoff_mm)
    mr_from_mean_probe = view @ world.truth.probe_from_plane.inverse()
    sweep = reframed(probe_path, mr_from_mean_probe, world.truth.probe_from_plane)
    name = f"real surfaces and ECG, {spec.preset}, seed {spec.seed}"
    shown = ecg.between(0.0, spec.seconds)
    return _assembled(name, world, anatomy.preop(), shown, sweep, with_start=False, progress=progress)


def cine_scenario(spec: ScenarioSpec, heart: CineHeart, progress: Report | None = None) -> Scenario:
    """Record a scenario on a real cine's heart: real MR, simulated ultrasound of its expert's labels.

    Args:
        spec: `motion` and kind of heart are not used: the cine has its own.
        heart: cine and labels.
        progress: called with the fraction done.
    Raises:
        InvalidInputError: labels of fewer than three slices, or a preset of another motion.
    """
    _keeps_its_motion(spec)
    seed = child_seed(spec.seeds.mismatch, "anatomy")
    anatomy = cine_anatomy(heart, mismatch_mm=spec.mismatch, seed=seed, surgery=spec.options.surgery)
    breaths, peaks_s, ecg = _signals(spec)
    world = make_world(spec, anatomy, peaks_s, breaths)
    _report_progress(progress, 0.12)
    sweep = sweeping_path(
        world.outline, world.window, spec.options.sweep, world.rng("probe path"), world.standoff_mm
    )
    name = f"real cine of {heart.patient_id}, {spec.preset}, seed {spec.seed}"
    return _assembled(name, world, heart.preop(), ecg, sweep, with_start=True, progress=progress)


def _keeps_its_motion(spec: ScenarioSpec) -> None:
    """Refuse presets whose change of motion only the phantom can make."""
    if spec.motion_change != UNCHANGED_MOTION:
        raise InvalidInputError(
            f"preset '{spec.preset}' changes how the heart moves, which only the phantom can; take "
            "--anatomy phantom, or another preset for surfaces and cines"
        )


def _breaths(spec: ScenarioSpec) -> Breaths:
    return draw_breaths(spec.options.respiration, spec.seconds, child_rng(spec.seed, "breaths"))


def _signals(spec: ScenarioSpec) -> tuple[Breaths, FloatArray, Signal]:
    """Draw breaths, R peaks, and the ECG, which breathing modulates."""
    breaths, options = _breaths(spec), spec.options
    volume = breaths.volume_at if options.respiration.moves else None
    beats = beat_series(options.rhythm, -3.0, spec.seconds + 3.0, child_rng(spec.seed, "rhythm"), volume)
    ecg = synthetic_ecg(beats, spec.seconds, options.ecg, child_rng(spec.seed, "ecg"), volume)
    return breaths, beats.r_peaks_s, ecg


def _assembled(
    name: str,
    world: World,
    preop: Preop,
    ecg: Signal,
    sweep: PosePath,
    *,
    with_start: bool,
    progress: Report | None,
) -> Scenario:
    spec, truth, anatomy = world.spec, world.truth, world.anatomy
    _report_progress(progress, 0.3)
    task = tool_task(world)
    _report_progress(progress, 0.4)
    looks = world.options.looks
    if looks.for_s > 0:
        sweep = looking_at(sweep, task.tip_mm, looks, world.rng("looks at the tool"))
    ultrasound = tracked_ultrasound(
        world, sweep, task, lambda share: _report_progress(progress, 0.4 + 0.57 * share)
    )
    options, center = world.options, anatomy.box_mm.mean(axis=0)
    tool, tool_after_restart = tracked_tool(world, task)
    landmarks = anatomy.landmarks()
    start = coarse_start(
        truth.mr_from_tracker, center, options.start_mm, options.start_deg, world.rng("start")
    )
    scenario = Scenario(
        name=name,
        preset=spec.preset,
        preop=preop,
        ecg=replace(ecg, start_s=ecg.start_s + options.ecg.latency_s),
        ultrasound=ultrasound,
        fan=world.probe.fan,
        tool=tool,
        tip=pivot_recording(truth.tip_in_tool, options.pivot_tracker, world.rng("pivot")),
        probe=_nwire(world),
        latency=watertank_recording(
            world.calibrated,
            world.probe.fan,
            truth.lag_s,
            options.watertank_tracker,
            options.watertank,
            world.rng("water tank"),
        ),
        start=start if with_start else None,
        landmarks_mr=landmarks,
        landmarks_tracker=touched_landmarks(landmarks, truth.mr_from_tracker, world.rng("landmarks")),
        touched=touched_surface(
            anatomy.surface_vertices(0.0),
            options.touched,
            truth.mr_from_tracker,
            world.rng("touched"),
        ),
        seed=spec.seed,
        tool_after_restart=tool_after_restart,
        **_breathing_recorded(world),
        truth=_truth(world, preop, task.contact),
    )
    _report_progress(progress, 1.0)
    return scenario


def _breathing_recorded(world: World) -> dict[str, Any]:
    """Record the breath as fields of a scenario."""
    if world.breathing is None or not world.breathing.spec.recorded:
        return {}
    return recorded_breathing(
        world.breathing, world.patient, world.spec.seconds, world.rng("breathing recorded")
    )


def _nwire(world: World) -> NWireRecording:
    options = world.options
    return nwire_recording(
        world.calibrated,
        world.probe.fan,
        (world.probe.columns, world.probe.rows),
        options.nwire_tracker,
        options.nwire,
        world.rng("n-wire"),
    )


def _truth(world: World, preop: Preop, contact: ToolTruth) -> ScenarioTruth:
    """Collect the ground truth, with the surface at TRUTH_PHASES phases."""
    anatomy, truth, surface, breathing = world.anatomy, world.truth, world.surface, world.breathing
    moving = SurfaceSeries(
        preop.surface,
        "mr",
        np.stack([surface.at(i / TRUTH_PHASES) for i in range(TRUTH_PHASES)]),
        surface.triangles,
        CycleTiming(np.arange(TRUTH_PHASES) / TRUTH_PHASES, anatomy.rr_s),
        preop.patient_id,
    )
    peaks = world.clock.r_peaks_s
    options = world.options
    other = options.other_probe_mm > 0 or options.other_probe_deg > 0
    return ScenarioTruth(
        mr_from_tracker=world.patient.steps(),
        probe_from_image=truth.probe_from_image,
        tip=truth.tip_in_tool,
        lag_s=truth.lag_s,
        r_peaks_s=peaks[(peaks >= 0.0) & (peaks < world.spec.seconds)],
        targets=anatomy.targets(),
        surface=moving,
        tool=contact,
        mismatch_mm=world.spec.mismatch,
        later_probe_from_image=world.image_maps()[1:],
        calibrated_probe_from_image=world.calibrated if other else None,
        video_drift_ppm=options.video_drift_ppm,
        respiration_mm=options.respiration.excursion_mm,
        breathing=None if breathing is None else breathing.truth(anatomy.targets(), world.spec.seconds),
    )


def _report_progress(progress: Report | None, share: float) -> None:
    if progress is not None:
        progress(share)
