"""`dvf-ig register`: where the patient is, from gated ultrasound or from a pair of images."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.agreement import require_agreement
from dvf_ig.cli.shell import (
    EcgRateOption,
    JsonFlag,
    ProbeNameOption,
    ReferenceNameOption,
    SeedOption,
    ThreadsOption,
    command,
    emit,
)

from . import own
from .kinds import Kind, kind_of
from .output import files_of, output_of_register, payload_of, require_usable, rows_of
from .pair import register_images
from .scenario import register_folder, register_own
from .volumes import UsVolumesOption, register_volume_files

if TYPE_CHECKING:
    from dvf_ig.intake.read import SessionRecordings


def register(
    scenario: Annotated[
        Path | None,
        typer.Argument(help="Scenario folder; or give --config, --us, --us-volume, or --fixed and --moving."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", callback=output_of_register, help="Folder, or a .tfm file, for the transform."
        ),
    ] = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="This patient's model, if `dvf-ig model build` made one.")
    ] = None,
    config: own.ConfigOption = None,
    us: own.UltrasoundOption = None,
    ecg: own.EcgOption = None,
    rate: EcgRateOption = None,
    ecg_start: own.EcgStartOption = None,
    mr: own.MrOption = None,
    labels: own.LabelsOption = None,
    organ: own.OrganOption = None,
    cavity: own.CavityOption = None,
    patient: own.PatientOption = None,
    probe: own.ProbeOption = None,
    lag_s: own.LagOption = None,
    latency: own.LatencyOption = None,
    start: own.StartOption = None,
    start_landmarks: own.StartLandmarksOption = None,
    touched: own.TouchedOption = None,
    fan: own.FanOption = None,
    probe_name: ProbeNameOption = None,
    reference_name: ReferenceNameOption = None,
    us_volume: UsVolumesOption = None,
    fixed: Annotated[Path | None, typer.Option("--fixed", help="3-D ultrasound image.")] = None,
    moving: Annotated[
        list[Path] | None,
        typer.Option("--moving", help="3-D MR or CT image; again for other contrasts in the same frame."),
    ] = None,
    mask: Annotated[Path | None, typer.Option("--mask", help="Mask on the fixed image's grid.")] = None,
    as_json: JsonFlag = False,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
) -> None:
    """Register ultrasound to the pre-operative model, and say whether the result may be used.

    Tracked frames, of a scenario folder, a SESSION.yaml, or named by options, and gated 3-D volumes give
    mr_from_tracker; an image pair gives moving_from_fixed. The evidence and a page are written in any case;
    exits 5, 6 or 7 when the pose must not be used.
    """
    with command(threads):
        from dvf_ig.io import output_folder

        if out is None:
            raise typer.BadParameter("say where to write: -o OUT")
        own_options = {
            "--model": model, "--mr": mr, "--labels": labels, "--organ": organ, "--cavity": cavity,
            "--patient": patient, "--ecg": ecg, "--rate": rate, "--ecg-start": ecg_start, "--probe": probe,
            "--lag-s": lag_s, "--latency": latency, "--fan": fan, "--probe-name": probe_name,
            "--reference-name": reference_name, "--start": start, "--start-landmarks": start_landmarks,
            "--touched": touched,
        }  # fmt: skip
        kind = kind_of(
            {
                Kind.scenario: scenario,
                Kind.config: config,
                Kind.recordings: us,
                Kind.volumes: us_volume,
                Kind.pair: fixed or moving,
            },
            own_options | {"--mask": mask},
        )
        name = "moving_from_fixed" if kind is Kind.pair else "mr_from_tracker"
        files = files_of(out, name)
        with output_folder(files.transform.parent, [path.name for path in files.every]):
            if scenario is not None:
                registered = register_folder(scenario, model, start, seed)
            elif kind is Kind.pair:
                registered = register_images(fixed, moving, start, mask, seed)
            elif us_volume is not None:
                registered = register_volume_files(us_volume, own_options, seed)
            else:
                registered = register_own(_recordings(config, us, own_options), seed)
            payload = payload_of(registered, name, seed)
            files.write(registered, payload, name)
        emit(payload, rows_of(registered, name), as_json=as_json)
        require_usable(registered)


def _recordings(config: Path | None, us: Path | None, options: dict[str, Any]) -> "SessionRecordings":
    from dvf_ig.intake.read import read_session

    if config is None:
        return own.read_recordings(us, options)
    return require_agreement(read_session(config), "register")
