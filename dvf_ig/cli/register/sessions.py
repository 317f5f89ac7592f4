"""`dvf-ig register SESSION`: mr_from_tracker from a sweep's gated frames, or from gated 3-D volumes."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from dvf_ig.cli.patient_model import patient_model
from dvf_ig.cli.session_argument import read_agreeing
from dvf_ig.cli.shell import progress, warn

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel
    from dvf_ig.intake.parts import SessionFiles
    from dvf_ig.registration import RegistrationResult
    from dvf_ig.replay.page.registration_page import ShownInput


def register_session(session: Path, model: Path | None, seed: int) -> "tuple[RegistrationResult, ShownInput]":
    """Register the ultrasound of a session from the start that it names."""
    files, doubts = read_agreeing(session, model, "register")
    for doubt in doubts:
        warn(f"{doubt.key}: {doubt.sentence}")
    built, origin = patient_model(files.heart, files.model or model)
    register = _register_frames if files.sweep is not None else _register_volumes
    result, shown = register(files, built, seed)
    typer.echo(origin, err=True)
    return result, shown


def _register_frames(
    files: "SessionFiles", model: "DvfModel", seed: int
) -> "tuple[RegistrationResult, ShownInput]":
    from dvf_ig.replay.page.registration_inputs import frames_shown
    from dvf_ig.replay.registration import explain_refusal, prepare_registration

    recorded = files.scenario
    with progress("register") as report:
        prepared = prepare_registration(
            recorded, model=model, seed=seed, progress=lambda share: report(0.6 * share)
        )
        result = prepared.register(seed=seed, progress=lambda share: report(0.6 + 0.4 * share))
    if not result.stop.usable:
        with progress("look for the cause"):
            cause = explain_refusal(prepared, result, seed=seed)
        if cause is not None:
            warn(cause)
    return result, frames_shown(result, prepared.frames, prepared.recording, recorded)


def _register_volumes(
    files: "SessionFiles", model: "DvfModel", seed: int
) -> "tuple[RegistrationResult, ShownInput]":
    from time import perf_counter

    from dvf_ig.intake.start import landmark_prior, landmarks_start, start_pose
    from dvf_ig.io import read_gated_volumes
    from dvf_ig.replay.page.registration_inputs import volumes_shown
    from dvf_ig.session import build_heart, register_gated_volumes

    heart, mr = build_heart(files.heart, model), files.heart.mr
    pose = start_pose(files.start, heart, seed)
    landmarks = pose if landmarks_start(files.start) else None
    volumes = read_gated_volumes(files.volumes, _model_phases(files, model))
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
    about = ", ".join(dict.fromkeys(file.path.name for file in files.volumes))
    return result, volumes_shown(result, volumes, heart, mr, about=about)


def _model_phases(files: "SessionFiles", model: "DvfModel") -> list[float]:
    """Where in the model's cycle each volume belongs; a phase without a heart rate is at the model's own."""
    from dvf_ig.cardiac import stream_recording
    from dvf_ig.session import model_phase_at

    peaks = () if files.ecg is None else stream_recording(files.ecg)[0]
    return [
        file.phase or 0.0 if file.t_s is None else model_phase_at(model, peaks, file.t_s)
        for file in files.volumes
    ]
