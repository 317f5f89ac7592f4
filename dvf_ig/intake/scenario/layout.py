"""What stands where in a scenario folder, and the schema of its `scenario.yaml`."""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.intake.schema import FanConfig, Whole
from dvf_ig.io.yaml_config import Section, read_yaml, validated
from dvf_ig.io.yaml_text import yaml_text

SCHEMA = "dvf_ig.scenario/1"
CONFIG = "scenario.yaml"
TRUTH = "truth"
README = "README.md"
PREVIEW = "preview.png"
TRIGGER = "trigger.csv"
"""In place of `ecg.csv`, where beats come from a trigger."""
SPEC = "spec.yaml"
"""Beside the truth, because it tells the ground truth."""


class PreopConfig(Section):
    """Which pre-operative data there are, and what their labels mean."""

    kind: Literal["labels", "surfaces", "labels and surfaces"]
    mr: str | None = None
    labels: str | None = None
    timing: str = "preop/timing.json"
    surfaces_folder: str = "preop"
    surfaces: tuple[str, ...] = ()
    surface: str = "EPICARDIAL"
    label_names: dict[int, str] = Field(default_factory=dict)
    organ_labels: tuple[int, ...] = ()


class FilesConfig(Section):
    """Paths relative to the scenario folder; `ecg` may also be `wfdb:…`, `edf:…`, `plus:…` or `trigger:…`."""

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


class ScenarioConfig(Section):
    """The content of `scenario.yaml`."""

    schema_: Literal["dvf_ig.scenario/1"] = Field(default="dvf_ig.scenario/1", alias="schema")
    name: str
    preset: str
    seed: Whole | None = None
    patient_id: str
    preop: PreopConfig
    fan: FanConfig | None = None
    files: FilesConfig = Field(default_factory=FilesConfig)


def read_config(folder: Path) -> ScenarioConfig:
    """Parse and check `scenario.yaml`.

    Raises:
        UnreadableFileError: no scenario folder, not YAML, unknown keys, or missing or wrong values.
    """
    path = folder / CONFIG
    if not path.is_file():
        what = (
            "it is a file (a SESSION.yaml is given as --config)"
            if folder.is_file()
            else f"it has no {CONFIG}"
        )
        raise UnreadableFileError(f"{folder} is not a scenario folder: {what}")
    document = read_yaml(path, "a scenario description")
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        got = document.get("schema") if isinstance(document, dict) else None
        raise UnreadableFileError(f"{path} has schema '{got}'; this version reads '{SCHEMA}'")
    return validated(ScenarioConfig, document, path)


def config_text(config: ScenarioConfig) -> str:
    """YAML of a configuration, keys in the order of the schema."""
    document: dict[str, Any] = config.model_dump(mode="json", by_alias=True)
    return yaml_text(document)
