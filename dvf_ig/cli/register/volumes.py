"""`dvf-ig register --model MODEL --us-volume FILE@PHASE …`: mr_from_tracker from gated 3-D ultrasound."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import warn

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel, Preop, Rigid, VolumeSeries
    from dvf_ig.io import GatedVolumeFile
    from dvf_ig.registration import LandmarkPrior

    from .output import Registered

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
MrOption = Annotated[
    Path | None, typer.Option("--mr", help="4-D MR or CT that the model was built from: its grey levels.")
]
VolumeEcgOption = Annotated[
    str | None, typer.Option("--ecg", help="ECG of volumes given as FILE=SECONDS: wfdb:, edf: or csv:.")
]
StartOption = Annotated[Path | None, typer.Option("--start", help="Coarse mr_from_tracker, ITK .tfm.")]
StartLandmarksOption = Annotated[
    tuple[Path, Path] | None,
    typer.Option(
        "--start-landmarks",
        metavar="MR TRACKER",
        help="The same anatomical points, by name, on the model and touched on the patient (.mrk.json, "
        ".fcsv); five or more also take part in the registration.",
    ),
]


def model_and_cine(model: Path | None, mr: Path | None) -> "tuple[Preop, DvfModel]":
    """The patient's model from its file, with the grey levels that it was built from where they are given."""
    from dvf_ig.core import Preop
    from dvf_ig.io import read_model

    if model is None:
        raise typer.BadParameter("--us-volume needs --model MODEL, which `dvf-ig model build` makes")
    fixture = read_model(model)
    return Preop(fixture.patient_id, mr=_cine(mr, fixture) if mr is not None else None), fixture


def register_volume_files(
    names: Sequence[str],
    preop: "Preop",
    model: "DvfModel",
    *,
    ecg: str | None,
    start: Path | None,
    landmarks: tuple[Path, Path] | None,
    seed: int,
) -> "Registered":
    from time import perf_counter

    from dvf_ig.io import gated_volume_files, read_gated_volumes
    from dvf_ig.session import build_heart, register_gated_volumes

    files = gated_volume_files(names)
    _require_matching(files, ecg, start, landmarks)
    pose, prior = _start(start, landmarks)
    volumes = read_gated_volumes([file.path for file in files], _model_phases(files, ecg, model))
    result = register_gated_volumes(
        volumes,
        build_heart(preop, model),
        pose,
        mr=preop.mr,
        seed=seed,
        clock=perf_counter,
        prior=prior,
        landmarks=pose if landmarks is not None else None,
    )
    return result, pose


def _require_matching(
    files: "Sequence[GatedVolumeFile]",
    ecg: str | None,
    start: Path | None,
    landmarks: tuple[Path, Path] | None,
) -> None:
    timed = next((file for file in files if file.t_s is not None), None)
    if timed is not None and ecg is None:
        raise typer.BadParameter(
            f"{timed.path}={timed.t_s:g} needs the ECG of that time: --ecg; or give its phase, "
            f"{timed.path}@PHASE"
        )
    if timed is None and ecg is not None:
        raise typer.BadParameter("--ecg belongs to volumes given as FILE=SECONDS; every one has its phase")
    if (start is None) == (landmarks is None):
        raise typer.BadParameter("give either --start FILE.tfm or --start-landmarks MR TRACKER")


def _start(file: Path | None, landmarks: tuple[Path, Path] | None) -> "tuple[Rigid, LandmarkPrior | None]":
    """The pose to start from, and the landmarks it came from as a prior."""
    from dvf_ig.io import read_landmarks, read_transform
    from dvf_ig.registration import prior_from_landmarks, start_from_landmarks

    if landmarks is not None:
        marked, touched = read_landmarks(landmarks[0], "mr"), read_landmarks(landmarks[1], "tracker")
        return start_from_landmarks(marked, touched).mr_from_tracker, prior_from_landmarks(marked, touched)
    if file is None:
        raise typer.BadParameter("give either --start FILE.tfm or --start-landmarks MR TRACKER")
    return read_transform(file, target="mr", source="tracker"), None


def _cine(file: Path, model: "DvfModel") -> "VolumeSeries":
    """The 4-D grey levels; where no times lie beside them, with those of the model's phases."""
    from dataclasses import replace

    from dvf_ig.io import read_volume_series

    cine = read_volume_series(file, frame=model.frame)
    if not cine.timing.timing_assumed:
        return cine
    if len(cine.timing) == model.phases:
        return replace(cine, timing=model.timing)
    warn(
        f"{file} has {len(cine.timing)} phases, the model {model.phases}: its phase i is taken to be at i/"
        f"{len(cine.timing)} of the cycle; put a timing.json beside it"
    )
    return cine


def _model_phases(files: "Sequence[GatedVolumeFile]", ecg: str | None, model: "DvfModel") -> list[float]:
    """Where in the model's cycle each volume belongs; a phase without a heart rate is at the model's own."""
    from dvf_ig.cardiac import stream_recording
    from dvf_ig.io import read_ecg
    from dvf_ig.session import model_phase_at

    peaks = stream_recording(read_ecg(ecg))[0] if ecg is not None else ()
    return [
        model_phase_at(model, peaks, file.t_s) if file.t_s is not None else file.phase or 0.0
        for file in files
    ]
