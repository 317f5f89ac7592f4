"""`dvf-ig register`: where the patient is, from gated ultrasound or from a pair of images."""

from pathlib import Path
from typing import Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, ThreadsOption, command, emit

from .output import files_of, payload_of, require_usable, rows_of
from .pair import register_images
from .scenario import register_recording


def register(
    scenario: Annotated[
        Path | None, typer.Argument(help="Scenario folder; or give --fixed and --moving.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Folder, or a .tfm file, for the transform and its page."),
    ] = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="This patient's model, if `dvf-ig model build` made one.")
    ] = None,
    fixed: Annotated[Path | None, typer.Option("--fixed", help="3-D ultrasound image.")] = None,
    moving: Annotated[Path | None, typer.Option("--moving", help="3-D MR or CT image.")] = None,
    init: Annotated[Path | None, typer.Option("--init", help="Start pose, ITK .tfm.")] = None,
    mask: Annotated[Path | None, typer.Option("--mask", help="Mask on the fixed image's grid.")] = None,
    as_json: JsonFlag = False,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
) -> None:
    """Register ultrasound to the pre-operative model, and say whether the result may be used.

    A scenario gives mr_from_tracker from its gated, tracked frames; an image pair gives moving_from_fixed.
    The evidence and a page are written in any case; exits 5, 6 or 7 when the pose must not be used.
    """
    with command(threads):
        from dvf_ig.io import output_folder

        if out is None:
            raise typer.BadParameter("say where to write: -o OUT")
        if (scenario is None) == (fixed is None and moving is None):
            raise typer.BadParameter("give either a scenario folder, or --fixed US and --moving MR")
        if scenario is None and model is not None:
            raise typer.BadParameter("--model belongs to a scenario folder; an image pair has no model")
        name = "mr_from_tracker" if scenario is not None else "moving_from_fixed"
        files = files_of(out, name)
        with output_folder(files.transform.parent):
            files.refuse_foreign()
            if scenario is not None:
                registered = register_recording(scenario, model, init, seed)
            else:
                registered = register_images(fixed, moving, init, mask, seed)
            payload = payload_of(registered.result, registered.start, name, seed)
            files.write(registered, payload, name)
        emit(payload, rows_of(registered.result, name), as_json=as_json)
        require_usable(registered.result)
