"""A scenario folder: what its `scenario.yaml` says, and the session that it is, by its files' names."""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io.ecg.trigger import split_ecg
from dvf_ig.io.file_within import path_within
from dvf_ig.io.yaml_config import Section, read_yaml, validated
from dvf_ig.io.yaml_text import yaml_text

from . import schema

SCHEMA = "dvf_ig.scenario/1"
CONFIG = "scenario.yaml"
TRUTH = "truth"
README = "README.md"
PREVIEW = "preview.png"
FIXTURES = "fixtures.yaml"
TRIGGER = "trigger.csv"
"""In place of `ecg.csv`, where beats come from a trigger."""
SPEC = "spec.yaml"
"""Beside the truth, because it tells the ground truth."""


class ScenarioPreop(Section):
    """Which pre-operative data there are, and what their labels mean."""

    kind: Literal["labels", "surfaces", "labels and surfaces"]
    mr: str | None = None
    views: tuple[str, ...] = ()
    labels: str | None = None
    timing: str = "preop/timing.json"
    surfaces_folder: str = "preop"
    surfaces: tuple[str, ...] = ()
    surface: str = "EPICARDIAL"
    label_names: dict[int, str] = Field(default_factory=dict)
    organ_labels: tuple[int, ...] = ()


class FilesConfig(Section):
    """Paths relative to the scenario folder; `ecg` may also be `wfdb:…`, `edf:…`, `plus:…` or `trigger:…`.

    `respiration` is what a session follows, as `read_respiration` takes it.
    """

    ecg: str = "ecg.csv"
    ultrasound: str = "ultrasound.igs.mha"
    tool: str = "tool.igs.mha"
    pivot: str = "calibration/pivot.igs.mha"
    nwire: str = "calibration/nwire.igs.mha"
    nwire_device_set: str = "calibration/nwire.xml"
    nwire_points: str = "calibration/nwire_points.xml"
    latency_tracker: str = "calibration/latency_tracker.igs.mha"
    latency_video: str = "calibration/latency_video.igs.mha"
    latency_lines: str = "calibration/latency_lines.xml"
    start: str | None = None
    landmarks_mr: str | None = None
    landmarks_tracker: str | None = None
    touched: str | None = None
    respiration: str | None = None
    ventilator: str | None = None
    chest: str | None = None
    fixtures: str | None = None


class ScenarioConfig(Section):
    """The content of `scenario.yaml`."""

    schema_: Literal["dvf_ig.scenario/1"] = Field(default="dvf_ig.scenario/1", alias="schema")
    name: str
    preset: str
    seed: schema.Whole | None = None
    patient_id: str
    preop: ScenarioPreop
    fan: schema.FanConfig | None = None
    files: FilesConfig = Field(default_factory=FilesConfig)


def read_scenario_config(folder: Path) -> ScenarioConfig:
    """Parse and check `scenario.yaml`.

    Raises:
        UnreadableFileError: no scenario folder, not YAML, unknown keys, or missing or wrong values.
    """
    path = folder / CONFIG
    if not path.is_file():
        what = "it is a file" if folder.is_file() else f"it has no {CONFIG}"
        raise UnreadableFileError(f"{folder} is not a scenario folder: {what}")
    document = read_yaml(path, "a scenario description")
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        got = document.get("schema") if isinstance(document, dict) else None
        raise UnreadableFileError(f"{path} has schema '{got}'; this version reads '{SCHEMA}'")
    config = validated(ScenarioConfig, document, path)
    preop = config.preop
    labelled, surfaced = preop.labels is not None, bool(preop.surfaces)
    if labelled is not ("labels" in preop.kind) or surfaced is not ("surfaces" in preop.kind):
        raise UnreadableFileError(f"{path}: preop kind is '{preop.kind}', its files differ")
    return config


def config_text(config: ScenarioConfig) -> str:
    """YAML of a configuration, keys in the order of the schema."""
    document: dict[str, Any] = config.model_dump(mode="json", by_alias=True)
    return yaml_text(document)


def session_of_scenario(folder: Path, *, truth: bool = True) -> schema.SessionConfig:
    """The session that a scenario folder is; the files that it names are not opened.

    Args:
        truth: name its truth if it has one.
    Raises:
        UnreadableFileError: no scenario folder, or its description is wrong or names files elsewhere.
    """
    config = read_scenario_config(folder)
    try:
        session = _session(config, folder, with_truth=truth and (folder / TRUTH).is_dir())
    except ValidationError as exc:
        problem = exc.errors()[0]
        key = ".".join(map(str, problem["loc"])) or "its files"
        raise UnreadableFileError(f"{folder / CONFIG}: {key}: {problem['msg']}") from exc
    for _, name in schema.named_files(session):
        path_within(folder, name, folder / CONFIG)
    return session


def _session(config: ScenarioConfig, folder: Path, *, with_truth: bool) -> schema.SessionConfig:
    files, preop = config.files, config.preop
    timing = path_within(folder, preop.timing, folder / CONFIG)
    return schema.SessionConfig(
        name=config.name,
        preset=config.preset,
        seed=config.seed,
        patient_id=config.patient_id,
        preop=schema.PreopConfig(
            mr=preop.mr,
            views=preop.views,
            labels=preop.labels,
            label_names=preop.label_names,
            organ_labels=preop.organ_labels,
            surfaces_folder=preop.surfaces_folder if preop.surfaces else None,
            surfaces=preop.surfaces,
            surface=preop.surface,
            timing=preop.timing if timing.is_file() else None,
        ),
        ultrasound=schema.UltrasoundConfig(file=files.ultrasound, fan=config.fan),
        ecg=schema.EcgConfig(file=files.ecg if split_ecg(files.ecg).prefix else f"csv:{files.ecg}"),
        tool=schema.ToolConfig(file=files.tool),
        respiration=None if files.respiration is None else schema.RespirationConfig(file=files.respiration),
        calibration=schema.CalibrationConfig(
            probe=schema.NWireConfig(
                phantom="nwire",
                file=files.nwire,
                device_set=files.nwire_device_set,
                points=files.nwire_points,
            ),
            latency=schema.LatencyConfig(
                tracker=files.latency_tracker, video=files.latency_video, lines=files.latency_lines
            ),
            tip=schema.PivotConfig(pivot=files.pivot),
        ),
        start=schema.StartConfig(
            transform=files.start,
            landmarks_mr=files.landmarks_mr,
            landmarks_tracker=files.landmarks_tracker,
            touched=files.touched,
        ),
        fixtures=files.fixtures,
        truth=TRUTH if with_truth else None,
    )
