"""Attach the files that a heart is built from to a log."""

from dvf_ig.core.model import DvfModel
from dvf_ig.core.recordings.scenario import Preop
from dvf_ig.intake.scenario import ScenarioPreop
from dvf_ig.intake.scenario_write import write_preop
from dvf_ig.intake.schema import PreopConfig
from dvf_ig.io.model.model_file import model_bytes
from dvf_ig.io.ros.log_file import LogWriter
from dvf_ig.io.writing.place import scratch_folder

MODEL = "preop/model.npz"


def attach_heart(log: LogWriter, preop: Preop, model: DvfModel | None) -> PreopConfig:
    """Attach the files of a heart, and return their configuration.

    With labels or surfaces the model is attached but not named in the configuration: otherwise the images
    would get the model's times.
    """
    has_labels = preop.labels is not None or preop.ed_labels is not None
    files = ScenarioPreop(
        kind="labels",
        mr="preop/mr.nrrd" if preop.mr is not None else None,
        labels="preop/labels.nrrd" if has_labels else None,
    )
    with scratch_folder() as folder:
        (folder / "preop").mkdir()
        has_files = has_labels or preop.mr is not None or bool(preop.surfaces)
        if has_files:
            write_preop(preop, folder, files)
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                log.attach(file.relative_to(folder).as_posix(), "application/octet-stream", file.read_bytes())
    if model is not None:
        log.attach(MODEL, "application/octet-stream", b"".join(model_bytes(model)))
    return PreopConfig(
        model=MODEL if model is not None and not has_labels and not preop.surfaces else None,
        mr=files.mr,
        labels=files.labels,
        ed_phase=preop.ed_phase,
        label_names=dict(preop.label_names),
        organ_labels=tuple(int(value) for value in preop.organ_labels),
        cavity_labels=tuple(int(value) for value in preop.cavity_labels),
        surfaces_folder="preop" if preop.surfaces else None,
        surfaces=tuple(series.name for series in preop.surfaces),
        surface=preop.surface,
        timing=files.timing if has_files else None,
    )
