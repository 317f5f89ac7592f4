"""`dvf-ig study constants`: every constant of registration, and what ± 30 % of it do to tuning hearts."""

from typing import Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, wrote

from .options import FolderOption, WorkersOption

GROUP = 20
"""Trials that a process works through before their lines are kept; it makes the hearts once."""


def constants(
    out: FolderOption,
    count: Annotated[
        int, typer.Option("--hearts", min=1, help="Tuning hearts; each is registered calm and poor.")
    ] = 2,
    workers: WorkersOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Register tracked sweeps of tuning hearts with each constant 30 % smaller and larger.

    Writes constants.md: value, what it does, which hearts it was chosen on, and the change of the median
    error; the columns are empty for constants that do not act in a tracked sweep.
    """
    with command(lists_inputs=False):
        from dvf_ig.io import output_folder, write_text
        from dvf_ig.study.constants.listing import registration_constants
        from dvf_ig.study.constants.table import table_markdown
        from dvf_ig.study.constants.trial import constant_trial, trial_numbers, varied_constants
        from dvf_ig.study.trials import Study, run_trials

        acting = varied_constants()
        numbers = trial_numbers(len(acting))
        settings = {"hearts": count, "constants": [constant.label for constant in acting]}
        with output_folder(out), progress("constants") as report:
            lines = run_trials(
                Study("constants", settings, constant_trial),
                numbers,
                out,
                workers=cores_or(workers),
                group_size=GROUP,
                progress=report,
            )
            write_text(out / "constants.md", table_markdown(registration_constants(), lines))
        emit(
            {"constants": len(acting), "trials": len(lines)},
            [("constants", str(len(acting)))],
            as_json=as_json,
        )
        wrote(out / "trials.jsonl")
        wrote(out / "constants.md")
