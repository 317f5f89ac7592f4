"""`dvf-ig register`: where the patient is, from a session's ultrasound, or how a pair of images lies."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from dvf_ig.cli.session_argument import SESSION, ModelOption, patient_model, read_agreeing
from dvf_ig.cli.shell import JsonFlag, SeedOption, ThreadsOption, command, emit, progress, warn

from .output import files_of, output_of_register, payload_of, require_usable, rows_of

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

    from dvf_ig.intake.start import landmark_fit, landmark_prior, landmarks_start, start_pose
    from dvf_ig.io import read_gated_volumes
    from dvf_ig.registration import against_touched
    from dvf_ig.replay.page.registration_inputs import volumes_shown
    from dvf_ig.session import build_heart, register_gated_volumes

    heart, mr = build_heart(files.heart, model), files.heart.mr
    pose = start_pose(files.start, heart, seed)
    volumes = read_gated_volumes(files.volumes, _model_phases(files, model))
    result = register_gated_volumes(
        volumes,
        heart,
        pose,
        mr=mr,
        seed=seed,
        clock=perf_counter,
        landmarks=landmark_prior(files.start),
    )
    if landmarks_start(files.start):
        result = against_touched(result, landmark_fit(files.start), None)
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


def register_images(
    fixed: Path | None, moving: list[Path] | None, init: Path | None, mask: Path | None, seed: int
) -> "tuple[RegistrationResult, ShownInput]":
    """Read a pair of images, ultrasound and one or more of MR or CT, and register it."""
    from time import perf_counter

    import numpy as np

    from dvf_ig.core import Rigid
    from dvf_ig.io import read_transform, read_volume
    from dvf_ig.registration import register_pair
    from dvf_ig.replay.page.registration_inputs import pair_shown

    if fixed is None or not moving:
        raise typer.BadParameter("an image pair needs both --fixed US and --moving MR")
    ultrasound = read_volume(fixed, frame="fixed")
    anatomies = [read_volume(path, frame="moving") for path in moving]
    start = (
        read_transform(init, target="moving", source="fixed")
        if init is not None
        else Rigid.identity("moving", "fixed")
    )
    allowed = read_volume(mask, frame="fixed") if mask is not None else None
    with progress("register") as report:
        result = register_pair(
            ultrasound,
            anatomies,
            start,
            rng=np.random.default_rng(seed),
            clock=perf_counter,
            mask=allowed,
            progress=report,
        )
    about = f"fixed {fixed.name}, moving {' and '.join(path.name for path in moving)}"
    return result, pair_shown(result, ultrasound, anatomies[0], about=about)


PAIR = "Image pair"


def register(
    out: Annotated[
        Path,
        Option("-o", "--out", callback=output_of_register, help="Folder, or a .tfm file, for the transform."),
    ],
    session: Annotated[
        Path | None, Argument(metavar="SESSION", help=f"{SESSION.capitalize()}; or give an image pair.")
    ] = None,
    model: ModelOption = None,
    fixed: Annotated[Path | None, Option(help="3-D ultrasound image.", rich_help_panel=PAIR)] = None,
    moving: Annotated[
        list[Path] | None,
        Option(help="3-D MR or CT image; again for other contrasts in the same frame.", rich_help_panel=PAIR),
    ] = None,
    init: Annotated[
        Path | None, Option(help="Coarse moving_from_fixed, ITK .tfm or .h5.", rich_help_panel=PAIR)
    ] = None,
    mask: Annotated[Path | None, Option(help="Mask on the fixed image's grid.", rich_help_panel=PAIR)] = None,
    as_json: JsonFlag = False,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
) -> None:
    """Register ultrasound to the pre-operative heart, and say whether the result may be used.

    A session's tracked frames or gated 3-D volumes give mr_from_tracker, an image pair gives
    moving_from_fixed. The evidence and a page are written in any case; exits 5, 6 or 7 when the pose must not
    be used.
    """
    with command(threads):
        from dvf_ig.io import output_folder

        pair = fixed is not None or bool(moving)
        if (session is None) is not pair:
            got = " (got both)" if pair else ""
            raise typer.BadParameter(f"give SESSION, {SESSION}, or --fixed US and --moving MR{got}")
        others = {"--model": model} if pair else {"--init": init, "--mask": mask}
        for option, value in others.items():
            if value is not None:
                goes = "SESSION" if pair else "--fixed and --moving"
                raise typer.BadParameter(f"{option} goes with {goes} alone")
        name = "moving_from_fixed" if session is None else "mr_from_tracker"
        files = files_of(out, name)
        with output_folder(files.transform.parent, [path.name for path in files.every]):
            if session is None:
                result, shown = register_images(fixed, moving, init, mask, seed)
            else:
                result, shown = register_session(session, model, seed)
            payload = payload_of(result, shown, name, seed)
            files.write(result, shown, payload, name)
        emit(payload, rows_of(result, name), as_json=as_json)
        require_usable(result)
