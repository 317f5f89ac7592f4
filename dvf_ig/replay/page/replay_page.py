"""Page of a replay: arrays over time, and ultrasound planes with the model in them."""

from typing import Any

import numpy as np

import dvf_ig
from dvf_ig.core import BoolArray, FloatArray, PhaseState, Signal
from dvf_ig.guidance import Hazard, SupervisorState
from dvf_ig.registration import target_errors_mm
from dvf_ig.replay.engine import Replay
from dvf_ig.replay.result.errors import true_contact, true_phases
from dvf_ig.replay.result.labels import change_of_shape, last_shown
from dvf_ig.replay.result.pose import suspensions
from dvf_ig.replay.table import table
from dvf_ig.report.plane_overlay import PlaneOverlay
from dvf_ig.report.replay import (
    BeatTrace,
    BreathLoop,
    EcgStrip,
    RegistrationMark,
    ReplayPage,
    SupervisorTrace,
    TickTrace,
    replay_html,
)
from dvf_ig.report.style import ESTIMATE, FAINT, GUIDE, START, WRONG
from dvf_ig.session.breathing_motion import REST_SHARE, FollowedBreath
from dvf_ig.session.pose_states import AGEING_MM_PER_S, MAX_AGE_S, MAX_BOUND_MM
from dvf_ig.session.pose_transition import SUSPEND_LOG_RATIO

from .planes import anatomy_of_heart, frame_overlays

STATE_COLORS = (
    (SupervisorState.OK, ESTIMATE),
    (SupervisorState.DEGRADED, START),
    (SupervisorState.FADE, FAINT),
    (SupervisorState.LATCHED, WRONG),
)
STRIP_S = 12.0


def report_html(replay: Replay, result: dict[str, Any]) -> str:
    """Build `report.html` for one replay and its result."""
    true_phase = None if replay.scenario.truth is None else true_phases(replay)[0]
    return replay_html(
        ReplayPage(
            scenario=result["scenario"],
            patient_id=result["patient_id"],
            version=dvf_ig.__version__,
            estimates=table(result),
            registrations=[
                RegistrationMark(a["ready_s"], a["usable"], a["reason"]) for a in result["registrations"]
            ],
            no_force=result["no_force"],
            without_force_s=result["without_force_s"],
            lost=_lost(replay, result),
            warnings=[f"{warning['key']}: {warning['sentence']}" for warning in result["warnings"]],
            overlays=_overlays(replay),
            beats=_beats(replay),
            breath=_breath_loop(replay),
            ticks=_ticks(replay, true_phase),
            supervisor=_supervisor(replay, result),
            ecg=_ecg_strip(replay, true_phase),
        )
    )


def _overlays(replay: Replay) -> list[PlaneOverlay]:
    """Overlay four frames of the last registration in use, or of the last that gave a pose at all."""
    attempt = last_shown(replay)
    images = replay.scenario.ultrasound.images
    if attempt is None or attempt.result is None or attempt.frames is None or images is None:
        return []
    return frame_overlays(
        attempt.frames,
        images,
        replay.setup.calibrations.probe_from_image,
        anatomy_of_heart(replay.heart, replay.scenario.preop.mr, change_of_shape(attempt)),
        replay.start,
        attempt.result.target_from_source,
    )


def _beats(replay: Replay) -> BeatTrace | None:
    beats, truth = replay.history.beats, replay.scenario.truth
    if not beats:
        return None
    tre_mm = None
    if truth is not None:
        targets = truth.targets.points
        tre_mm = np.array(
            [
                target_errors_mm(b.measurement.pose, truth.mr_from_tracker_at(b.end_s), targets).mean()
                for b in beats
            ]
        )
    return BeatTrace(
        decided_s=np.array([beat.decided_s for beat in beats]),
        in_use=np.array([beat.in_use for beat in beats]),
        log_likelihood_ratio=np.array([beat.measurement.log_likelihood_ratio for beat in beats]),
        tre_mm=tre_mm,
        limit=SUSPEND_LOG_RATIO,
        suspended_s=suspensions(tuple(replay.history.updates), float(replay.ticks.t_s[-1])),
    )


def _breath_loop(replay: Replay) -> BreathLoop | None:
    """Describe the last breaths that forces followed; None without any."""
    recorded = replay.scenario.respiration
    breath = next((one.breath for one in reversed(replay.history.breathing) if one.breath), None)
    if breath is None or recorded is None:
        return None
    model, beats = breath.model, breath.beats
    middles = np.array([beat.frames[len(beat.frames) // 2] for beat in beats])
    residual_mm, sigma_mm = model.residuals_mm(beats)
    return BreathLoop(
        surrogate=recorded.name,
        rho=middles[:, 1],
        displacement_mm=model.displacement_mm(middles - breath.rest) + residual_mm,
        residual_mm=residual_mm,
        sigma_mm=sigma_mm,
        inspiration=_rises(middles),
        course_rho=breath.features[:, 1],
        course_mm=model.displacement_mm(breath.features - breath.rest),
        course_inspiration=_rises(breath.features),
        true_mm=_true_displacement_mm(replay, breath),
        breaths=model.breaths,
        held_out_mm=model.held_out_mm,
    )


def _rises(features: FloatArray) -> BoolArray:
    """Return whether ρ rises at (n, 4) features: it leads its lag."""
    return np.asarray(features[:, 1] > features[:, 2])


def _true_displacement_mm(replay: Replay, breath: FollowedBreath) -> FloatArray | None:
    """Compute the true displacement of the heart's centre in these breaths; None without a truth."""
    truth = replay.scenario.truth
    if truth is None or truth.breathing is None:
        return None
    center, motion = replay.heart.center_mm, truth.breathing
    moved = motion.mr_from_rest[:, :, :3] @ center + motion.mr_from_rest[:, :, 3] - center
    along_mm = -moved @ breath.model.along[3:]  # ξ takes the heart back to its rest
    course_mm = np.interp(breath.t_s, motion.t_s, along_mm).mean(axis=0)
    level = breath.features[:, 1:].max(axis=1)
    resting = level <= np.quantile(level, REST_SHARE)
    return np.asarray(course_mm - course_mm[resting].mean())


def _ticks(replay: Replay, true_phase: FloatArray | None) -> TickTrace:
    ticks, track = replay.ticks, replay.ticks.phase
    distance = force = error = None
    if true_phase is not None:
        distance, true_force = true_contact(replay)
        force = None if true_force is None else np.linalg.norm(true_force, axis=1)
        if not replay.setup.fixtures.fixtures[0].on_model:
            distance = None  # the fixture's distance is that to the path or the structure
        error = 100 * ((track.phi - true_phase + 0.5) % 1.0 - 0.5)
    return TickTrace(
        t_s=track.t_s,
        valid=ticks.valid,
        phase_valid=track.valid,
        force_n=np.linalg.norm(ticks.force_n, axis=1),
        distance_mm=ticks.distance_mm,
        true_force_n=force,
        true_distance_mm=distance,
        phase_error_percent=error,
    )


def _lost(replay: Replay, result: dict[str, Any]) -> str | None:
    """Say why no force could be given at the end: no pose, or a latch; None if one could."""
    ticks, withheld = replay.ticks, result["withheld"]
    end_s = float(ticks.t_s[-1])
    if withheld and withheld[-1]["end_s"] == end_s:
        return f"from {withheld[-1]['begin_s']:.1f} s on {withheld[-1]['why']}"
    if ticks.supervisor[-1] == int(SupervisorState.LATCHED):
        latched = np.flatnonzero(ticks.supervisor != int(SupervisorState.LATCHED))
        since_s = float(ticks.t_s[latched[-1] + 1]) if len(latched) else float(ticks.t_s[0])
        return f"latched from {since_s:.1f} s on"
    return None


def _supervisor(replay: Replay, result: dict[str, Any]) -> SupervisorTrace:
    """Trace the four states, then the hazards, as far as they occurred; and the pose's age with its rules."""
    ticks = replay.ticks
    states = [(state.name.lower(), color, ticks.supervisor == state) for state, color in STATE_COLORS]
    hazards = [
        (hazard.name.lower().replace("_", " "), GUIDE, ticks.hazards & hazard != 0)
        for hazard in Hazard
        if hazard.name
    ]
    bands = tuple(band for band in (*states, *hazards) if band[2].any())
    withheld = tuple((span["begin_s"], span["end_s"], span["rule"]) for span in result["withheld"])
    fresh_bound_mm = ticks.pose_bound_mm - AGEING_MM_PER_S * ticks.pose_age_s
    limit_s = np.clip((MAX_BOUND_MM - fresh_bound_mm) / AGEING_MM_PER_S, 0.0, MAX_AGE_S)
    return SupervisorTrace(ticks.t_s, ticks.pose_age_s, limit_s, withheld, bands)


def _ecg_strip(replay: Replay, true_phase: FloatArray | None) -> EcgStrip:
    """Cut out STRIP_S seconds in the middle of the recording."""
    ecg, track = replay.scenario.ecg, replay.ticks.phase
    wave = ecg if isinstance(ecg, Signal) else None
    middle = float(track.t_s[len(track.t_s) // 2])
    begin = max(float(track.t_s[0]), middle - STRIP_S / 2)
    end = begin + STRIP_S
    shown = (ecg.t_s >= begin) & (ecg.t_s < end)
    t_s = ecg.t_s[shown]
    ticks = (track.t_s >= begin) & (track.t_s < end)
    return EcgStrip(
        label="trigger" if wave is None else f"{wave.leads[0]}, {wave.unit}",
        ecg_t_s=t_s,
        ecg=None if wave is None else wave.samples[shown, 0],
        r_peaks_s=np.array([peak.t_s for peak in replay.history.peaks if begin <= peak.t_s < end]),
        t_s=track.t_s[ticks],
        phase=track.phi[ticks],
        phase_valid=track.state[ticks] == int(PhaseState.LOCKED),
        true_phase=None if true_phase is None else true_phase[ticks],
    )
