"""The model of a recorded patient: from a given file, from the cache, or built."""

from pathlib import Path

import typer

from dvf_ig.core import DvfModel, Preop

from .shell import progress


def patient_model(preop: Preop, file: Path | None) -> DvfModel:
    """The model in `file` where one is given, else from the cache or built; says so in one line on stderr."""
    from dvf_ig.io import cached_model, read_model

    if file is not None:
        model = read_model(file, patient_id=preop.patient_id)
        typer.echo(f"model from {file}", err=True)
        return model
    with progress("model") as report:
        found = cached_model(preop, progress=report)
    typer.echo(found.remark, err=True)
    return found.model
