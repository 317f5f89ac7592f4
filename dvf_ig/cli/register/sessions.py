"""`dvf-ig register SESSION`: mr_from_tracker from a sweep's gated frames, or from gated 3-D volumes."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from dvf_ig.cli.patient_model import patient_model
from dvf_ig.cli.session_argument import read_agreeing
from dvf_ig.cli.shell import progress, warn

from .output import Registered

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel
    from dvf_ig.intake.parts import SessionFiles


def register_session(session: Path, model: Path | None, seed: int) -> Registered:
    """Register the ultrasound of a session from the start that it names."""
    files, doubts = read_agreeing(session, model, "register")
    for doubt in doubts:
        warn(f"{doubt.key}: {doubt.sentence}")
    built, origin = patient_model(files.heart, files.model or model)
    if files.sweep is None:
        registered = _register_volumes(files, built, seed)
    else:
        registered = _register_frames(files, built, seed)
    typer.echo(origin, err=True)
    return registered


def _register_frames(files: "SessionFiles", model: "DvfModel", seed: int) -> Registered:
    from dvf_ig.replay import register_scenario
    from dvf_ig.replay.page.registration_inputs import frames_shown

    recorded = files.scenario
    with progress("register") as report:
        registered = register_scenario(recorded, model=model, seed=seed, progress=report)
    shown = replace(frames_shown(registered, recorded.name, recorded.preop.mr), targets=recorded.landmarks_mr)
    return Registered(registered.result, registered.start, shown, recorded.tracked_against)


def _register_volumes(files: "SessionFiles", model: "DvfModel", seed: int) -> Registered:
    from time import perf_counter

    from dvf_ig.io import read_gated_volumes
    from dvf_ig.replay.page.registration_inputs import volumes_shown
    from dvf_ig.replay.start import landmark_prior, landmarks_start, start_pose
    from dvf_ig.session import build_heart, register_gated_volumes

    heart, mr = build_heart(files.heart, model), files.heart.mr
    pose = start_pose(files.start, heart, seed)
    landmarks = pose if landmarks_start(files.start) else None
    volumes = read_gated_volumes([file.path for file in files.volumes], _model_phases(files, model))
    result = register_gated_volumes(
        volumes,
        heart,
        pose,
        mr=mr,
        seed=seed,
        clock=perf_counter,
        prior=landmark_prior(files.start),
        landmarks=landmarks,
    )
    about = ", ".join(file.path.name for file in files.volumes)
    shown = volumes_shown(result, pose, volumes, heart, mr, landmarks=landmarks, about=about)
    return Registered(result, pose, shown)


def _model_phases(files: "SessionFiles", model: "DvfModel") -> list[float]:
    """Where in the model's cycle each volume belongs; a phase without a heart rate is at the model's own."""
    from dvf_ig.cardiac import stream_recording
    from dvf_ig.session import model_phase_at

    peaks = () if files.ecg is None else stream_recording(files.ecg)[0]
    return [
        file.phase or 0.0 if file.t_s is None else model_phase_at(model, peaks, file.t_s)
        for file in files.volumes
    ]
