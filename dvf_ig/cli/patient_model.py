"""The model of a recorded patient: from a file, from the cache, or built."""

from pathlib import Path
from typing import TYPE_CHECKING

from .shell import progress

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel, Preop


def patient_model(preop: "Preop", given: "DvfModel | Path | None") -> "tuple[DvfModel, str]":
    """The given model or the one in a file, else from the cache or built; and one line that says so."""
    from dvf_ig.core import DvfModel
    from dvf_ig.intake import cached_model
    from dvf_ig.io import read_model

    if isinstance(given, DvfModel):
        return given, f"model of patient {given.patient_id}"
    if given is not None:
        return read_model(given, patient_id=preop.patient_id), f"model from {given}"
    with progress("model") as report:
        cached = cached_model(preop, progress=report)
    return cached.model, cached.remark
