"""`dvf-ig study constants`: every constant of registration, and what ± 30 % of it do to tuning hearts."""

from typing import Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, wrote

from .options import FolderOption, WorkersOption

GROUP = 20
"""Trials that a process works through before their lines are kept; it makes the cases once."""


def constants(
    out: FolderOption,
    count: Annotated[
        int,
        typer.Option("--hearts", min=1, help="Tuning hearts, and as many brains; each is registered twice."),
    ] = 2,
    workers: WorkersOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Register tuning hearts and brains with each constant 30 % smaller and larger.

    Writes constants.md: value, what it does, which hearts it was chosen on, and how the mean error changes in
    tracked sweeps, gated volumes (both calm and poor) or pairs of organs (T1 and FLAIR), whichever the
    constant acts in; the columns are empty for constants that act in none of them.
    """
    with command(lists_inputs=False):
        from dvf_ig.io import output_folder, write_text
        from dvf_ig.study.constants.listing import registration_constants
        from dvf_ig.study.constants.table import constants_page
        from dvf_ig.study.constants.trial import constant_trial, variations
        from dvf_ig.study.trials import Study, run_trials

        tried = variations()
        labels = [variation.constant.label for variation in tried if variation.constant is not None]
        names = list(dict.fromkeys(labels))
        settings = {"hearts": count, "constants": names}
        with output_folder(out, ["constants.md"]), progress("constants") as report:
            lines = run_trials(
                Study("constants", settings, constant_trial),
                range(len(tried)),
                out,
                workers=cores_or(workers),
                group_size=GROUP,
                progress=report,
            )
            write_text(out / "constants.md", constants_page(registration_constants(), lines, count))
        emit(
            {"constants": len(names), "trials": len(lines)},
            [("constants", str(len(names)))],
            as_json=as_json,
        )
        wrote(out / "trials.jsonl")
        wrote(out / "constants.md")
