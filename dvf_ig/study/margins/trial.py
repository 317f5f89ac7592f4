"""One trial: a recording of one heart through a session, whose wall is compared with the true surface.

Nothing is assumed of the errors: pose, phase, tip and model are what the session made of the raw streams, and
are compared with the simulator's truth. σ is what the session itself states. So errors and σ come from
different sources, as with a patient.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from data_synth import ScenarioSpec, child_rng, phantom_scenario
from dvf_ig.core import FloatArray, InvalidInputError, Scenario, ScenarioTruth
from dvf_ig.guidance import Evaluator, Sigmoid, Status
from dvf_ig.intake import cached_model
from dvf_ig.replay import events_of
from dvf_ig.replay.calibrations import calibrate
from dvf_ig.replay.preconditions import tool_of
from dvf_ig.replay.start import landmarks_start, start_pose
from dvf_ig.session import GuidanceState, Heart, Session, SessionSetup, beat_source_of, build_heart
from dvf_ig.session.margins import sigma_at
from dvf_ig.study.hearts.registered import MOTION, VARIED
from dvf_ig.study.trials import Line, Settings

STATE_EVERY_S = 0.1
SAMPLED_EVERY = 5
"""The session is asked every 0.1 s for its state, and its wall is compared at every fifth answer."""
PLACES = 40
"""Places of the true surface, drawn anew at each time."""


def trial_numbers(hearts: Sequence[int], settings: Settings) -> list[int]:
    """Numbers of the trials of these hearts; those of one heart follow one another."""
    presets = len(settings["presets"])
    return [heart * presets + place for heart in hearts for place in range(presets)]


def margin_trial(settings: Settings, number: int) -> Line:
    """Errors of the wall's distance, and σ by its causes, over places and times of one recording.

    Args:
        settings: `presets`, `seconds`.
        number: heart × number of presets + place of the preset.
    """
    presets = settings["presets"]
    seed, preset = number // len(presets), presets[number % len(presets)]
    motion: Any = MOTION[seed % 2]
    scenario = phantom_scenario(ScenarioSpec(preset, motion, settings["seconds"], seed, heart=VARIED))
    samples = list(_samples(scenario, seed))
    columns = np.concatenate(samples, axis=1) if samples else np.empty((4, 0))
    names = ("error_mm", "registration_mm", "phase_mm", "ageing_mm")
    return {
        "heart": seed,
        "preset": preset,
        "times": len(samples),
        **{name: column.round(3).tolist() for name, column in zip(names, columns, strict=True)},
    }


def _samples(scenario: Scenario, seed: int) -> Iterator[FloatArray]:
    """(4, PLACES) error of the distance and three of its σ, mm, for each time with pose and phase."""
    truth = scenario.truth
    if truth is None:
        raise InvalidInputError("margins are judged by a truth; this scenario carries none")
    heart = build_heart(scenario.preop, cached_model(scenario.preop).model)
    calibrations = calibrate(scenario, seed).in_use
    setup = SessionSetup(
        heart,
        calibrations,
        beat_source_of(scenario.ecg),
        start=None if landmarks_start(scenario) else start_pose(scenario, heart, seed),
        fan=scenario.fan,
        seed=seed,
    )
    tip_error = _tip_errors(scenario, truth, calibrations.tip.xyz_mm[0])
    wall, rng = Evaluator(heart.model, Sigmoid()), child_rng(seed, "margin trial")
    events = events_of(scenario)
    upcoming = next(events)
    with Session(setup) as session:
        times = np.arange(0.0, float(scenario.ultrasound.t_s[-1]), STATE_EVERY_S).tolist()
        for i, now_s in enumerate(times):
            while upcoming[0] <= now_s:
                session.push(upcoming[1])
                upcoming = next(events, (np.inf, upcoming[1]))
            state = session.state(now_s)
            if i % SAMPLED_EVERY == 0 and int(state.transform.at(np.zeros((1, 3)), now_s).status[0]) == 0:
                yield _compared(state, heart, truth, wall, tip_error(now_s), rng)


def _compared(
    state: GuidanceState,
    heart: Heart,
    truth: ScenarioTruth,
    wall: Evaluator,
    tip_error_mm: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Places of the true surface, touched by a tip that the session sees with its error of that moment."""
    now_s, transform = state.now_s, state.transform
    phase = truth.tool.model_phase[int(np.abs(truth.tool.t_s - now_s).argmin())]
    surface = _surface_at(truth, float(phase))
    places = surface[rng.integers(len(surface), size=PLACES)]
    touched = truth.mr_from_tracker_at(now_s).inverse().apply_array(places) + tip_error_mm
    found = transform.evaluate(wall, touched, now_s)
    inside = found.status == int(Status.OK)
    rotation = transform.pose.at(now_s).rotation if transform.pose is not None else np.eye(3)
    sigma = sigma_at(
        transform,
        touched[inside],
        now_s,
        found.gradient[inside] @ rotation.T,
        found.rate_mm_per_cycle[inside],
        state.pose_age_s,
    )
    # on the true surface the distance is zero
    return np.array([-found.distance_mm[inside], sigma.registration_mm, sigma.phase_mm, sigma.breathing_mm])


def _surface_at(truth: ScenarioTruth, phase: float) -> FloatArray:
    """(k, 3) the true surface at a model phase, linear between its neighbours; frame "mr"."""
    first, second, alpha = truth.surface.timing.bracket(phase)
    vertices = truth.surface.vertices_mm
    return np.asarray((1.0 - alpha) * vertices[first] + alpha * vertices[second])


def _tip_errors(
    scenario: Scenario, truth: ScenarioTruth, tip_mm: FloatArray
) -> Callable[[float], FloatArray]:
    """The error (3,) of the tracked tip at a time, tracker frame: what calibration and tracker made of it."""
    tool = tool_of(scenario)
    tracked = np.flatnonzero(tool.valid)

    def at(t_s: float) -> FloatArray:
        k = int(tracked[np.abs(tool.t_s[tracked] - t_s).argmin()])
        seen = tool.pose(k).apply_array(tip_mm[None])[0]
        own = int(np.abs(truth.tool.t_s - tool.t_s[k]).argmin())
        tracker_from_mr = truth.mr_from_tracker_at(float(tool.t_s[k])).inverse()
        return np.asarray(seen - tracker_from_mr.apply_array(truth.tool.tip_mr_mm[own][None])[0])

    return at
