"""`dvf-ig register`: where the patient is, from gated ultrasound or from a pair of images."""

from pathlib import Path
from typing import Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, ThreadsOption, command, emit, wrote

from .output import files_of, payload_of, require_usable, rows_of
from .pair import register_images
from .scenario import register_recording
from .volumes import (
    MrOption,
    StartLandmarksOption,
    StartOption,
    UsVolumesOption,
    VolumeEcgOption,
    model_and_cine,
    register_volume_files,
)


def register(
    scenario: Annotated[
        Path | None, typer.Argument(help="Scenario folder; or give --fixed and --moving.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder, or a .tfm file, for the transform.")
    ] = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="This patient's model, if `dvf-ig model build` made one.")
    ] = None,
    fixed: Annotated[Path | None, typer.Option("--fixed", help="3-D ultrasound image.")] = None,
    moving: Annotated[Path | None, typer.Option("--moving", help="3-D MR or CT image.")] = None,
    init: Annotated[Path | None, typer.Option("--init", help="Start pose, ITK .tfm.")] = None,
    mask: Annotated[Path | None, typer.Option("--mask", help="Mask on the fixed image's grid.")] = None,
    us_volume: UsVolumesOption = None,
    mr: MrOption = None,
    ecg: VolumeEcgOption = None,
    start_file: StartOption = None,
    start_landmarks: StartLandmarksOption = None,
    as_json: JsonFlag = False,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
) -> None:
    """Register ultrasound to the pre-operative model, and say whether the result may be used.

    A scenario gives mr_from_tracker from its gated, tracked frames, gated 3-D volumes (--us-volume) the same;
    an image pair gives moving_from_fixed.
    The evidence is written in any case; exits 5, 6 or 7 when the pose must not be used.
    """
    with command(threads):
        from dvf_ig.io import output_folder, refuse_foreign, write_sidecar, write_transforms

        if out is None:
            raise typer.BadParameter("say where to write: -o OUT")
        if (scenario is not None) + (fixed is not None or moving is not None) + bool(us_volume) != 1:
            raise typer.BadParameter(
                "give a scenario folder, or --us-volume FILE@PHASE …, or --fixed US and --moving MR"
            )
        if fixed is not None and model is not None:
            raise typer.BadParameter("--model belongs to a scenario folder; an image pair has no model")
        if not us_volume and any(given is not None for given in (mr, ecg, start_file, start_landmarks)):
            raise typer.BadParameter("--mr, --ecg, --start and --start-landmarks belong to --us-volume")
        if us_volume and (init is not None or mask is not None):
            raise typer.BadParameter("--init and --mask do not belong to --us-volume; it has --start")
        name = "moving_from_fixed" if fixed is not None or moving is not None else "mr_from_tracker"
        transform, evidence = files_of(out, name)
        with output_folder(transform.parent):
            refuse_foreign(evidence, kind="registration")
            refuse_foreign(transform.with_suffix(".json"), kind="transform")
            if us_volume:
                result, start = register_volume_files(
                    us_volume,
                    *model_and_cine(model, mr),
                    ecg=ecg,
                    start=start_file,
                    landmarks=start_landmarks,
                    seed=seed,
                )
            elif scenario is not None:
                result, start = register_recording(scenario, model, init, seed)
            else:
                result, start = register_images(fixed, moving, init, mask, seed)
            payload = payload_of(result, start, name, seed)
            for file in write_transforms(result.target_from_source, transform):
                wrote(file, name)
            write_sidecar(evidence, payload, "registration")
        wrote(evidence)
        emit(payload, rows_of(result, name), as_json=as_json)
        require_usable(result)
