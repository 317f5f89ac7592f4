"""`dvf-ig register --model MODEL --us-volume FILE@PHASE …`: mr_from_tracker from gated 3-D ultrasound."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.patient_model import patient_model

from . import own

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel, Rigid
    from dvf_ig.io import GatedVolumeFile
    from dvf_ig.registration import LandmarkPrior, RegistrationResult
    from dvf_ig.replay.page.registration_page import ShownInput

UsVolumesOption = Annotated[
    list[str] | None,
    typer.Option(
        "--us-volume",
        metavar="FILE@PHASE|FILE=SECONDS",
        help="Gated 3-D ultrasound image, as often as there are volumes. Its header places it: its LPS "
        "coordinates, in mm, are the tracker's. PHASE: fraction of the RR interval, 0 to below 1, in a heart "
        "that beats at the model's rate; SECONDS: when it was taken on the clock of --ecg, which gives the "
        "phase and corrects for the heart rate.",
    ),
]


def register_volume_files(
    names: Sequence[str], options: Mapping[str, Any], seed: int
) -> "tuple[RegistrationResult, ShownInput]":
    """Volumes named FILE@PHASE or FILE=SECONDS.

    Args:
        options: by their names on the command line; None if they were not given.
    """
    from time import perf_counter

    from dvf_ig.io import gated_volume_files, read_gated_volumes
    from dvf_ig.replay.page.registration_inputs import volumes_shown
    from dvf_ig.session import build_heart, register_gated_volumes

    files = gated_volume_files(names)
    _require_matching(files, options)
    pose, prior = _start(options["--start"], options["--start-landmarks"])
    read = own.read_heart(options)
    model, origin = patient_model(read.preop, read.model)
    phases = _model_phases(files, options, model)
    volumes = read_gated_volumes([file.path for file in files], phases)
    heart, mr = build_heart(read.preop, model), read.preop.mr
    result = register_gated_volumes(
        volumes,
        heart,
        pose,
        mr=mr,
        seed=seed,
        clock=perf_counter,
        prior=prior,
        landmarks=None if options["--start-landmarks"] is None else pose,
    )
    typer.echo(origin, err=True)
    about = ", ".join(file.path.name for file in files)
    return result, volumes_shown(result, volumes, heart, mr, about=about)


def _require_matching(files: "Sequence[GatedVolumeFile]", options: Mapping[str, Any]) -> None:
    own.require_heart(options)
    timed, ecg = next((file for file in files if file.t_s is not None), None), options["--ecg"]
    if timed is not None and ecg is None:
        raise typer.BadParameter(
            f"{timed.path}={timed.t_s:g} needs the ECG of that time: --ecg; or give its phase, "
            f"{timed.path}@PHASE"
        )
    if timed is None and ecg is not None:
        raise typer.BadParameter("--ecg belongs to volumes given as FILE=SECONDS; every one has its phase")


def _start(file: Path | None, landmarks: tuple[Path, Path] | None) -> "tuple[Rigid, LandmarkPrior | None]":
    """The pose to start from, and the landmarks it came from as a prior."""
    from dvf_ig.io import read_landmarks, read_transform
    from dvf_ig.registration import prior_from_landmarks, start_from_landmarks

    if landmarks is not None and file is None:
        marked, touched = read_landmarks(landmarks[0], "mr"), read_landmarks(landmarks[1], "tracker")
        return start_from_landmarks(marked, touched).mr_from_tracker, prior_from_landmarks(marked, touched)
    if file is not None and landmarks is None:
        return read_transform(file, target="mr", source="tracker"), None
    raise typer.BadParameter("give either --start FILE.tfm or --start-landmarks MR TRACKER")


def _model_phases(
    files: "Sequence[GatedVolumeFile]", options: Mapping[str, Any], model: "DvfModel"
) -> list[float]:
    """Where in the model's cycle each volume belongs; a phase without a heart rate is at the model's own."""
    from dvf_ig.cardiac import stream_recording
    from dvf_ig.io import read_ecg
    from dvf_ig.session import model_phase_at

    ecg = options["--ecg"]
    peaks = stream_recording(read_ecg(ecg, options["--rate"]))[0] if ecg is not None else ()
    return [
        model_phase_at(model, peaks, file.t_s) if file.t_s is not None else file.phase or 0.0
        for file in files
    ]
