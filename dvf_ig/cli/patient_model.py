"""The model of a recorded patient: from a given file, from the cache, or built."""

from pathlib import Path

from dvf_ig.core import DvfModel, Preop

from .shell import progress


def patient_model(preop: Preop, file: Path | None) -> tuple[DvfModel, str]:
    """The model in `file` where one is given, else from the cache or built; and one line that says so."""
    from dvf_ig.io import cached_model, read_model

    if file is not None:
        return read_model(file, patient_id=preop.patient_id), f"model from {file}"
    with progress("model") as report:
        found = cached_model(preop, progress=report)
    return found.model, found.remark
