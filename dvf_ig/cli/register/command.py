"""`dvf-ig register`: where the patient is, from a session's ultrasound, or how a pair of images lies."""

from pathlib import Path
from typing import Annotated

import typer

from dvf_ig.cli.session_argument import SESSION, ModelOption
from dvf_ig.cli.shell import JsonFlag, SeedOption, ThreadsOption, command, emit

from .output import files_of, output_of_register, payload_of, require_usable, rows_of
from .pair import register_images
from .sessions import register_session

PAIR = "Image pair"


def register(
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", callback=output_of_register, help="Folder, or a .tfm file, for the transform."
        ),
    ],
    session: Annotated[
        Path | None,
        typer.Argument(metavar="SESSION", help=f"{SESSION.capitalize()}; or give an image pair."),
    ] = None,
    model: ModelOption = None,
    fixed: Annotated[
        Path | None, typer.Option("--fixed", help="3-D ultrasound image.", rich_help_panel=PAIR)
    ] = None,
    moving: Annotated[
        list[Path] | None,
        typer.Option(
            "--moving",
            help="3-D MR or CT image; again for other contrasts in the same frame.",
            rich_help_panel=PAIR,
        ),
    ] = None,
    init: Annotated[
        Path | None,
        typer.Option("--init", help="Coarse moving_from_fixed, ITK .tfm or .h5.", rich_help_panel=PAIR),
    ] = None,
    mask: Annotated[
        Path | None, typer.Option("--mask", help="Mask on the fixed image's grid.", rich_help_panel=PAIR)
    ] = None,
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
