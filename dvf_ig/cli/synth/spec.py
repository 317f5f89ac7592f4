"""Strict reader and writer of the YAML that describes a synthetic scenario in full."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.io.yaml_config import read_yaml
from dvf_ig.io.yaml_text import yaml_text

if TYPE_CHECKING:
    from data_synth import CalibratedImage, HeartSpec, Preset, ScenarioSpec

SCHEMA = "dvf_ig.scenario-spec/1"
_KEYS = {"occlusion": "sight"}
"""Keys of the file that differ from the names of their fields, to keep the format."""
_FIELDS = {key: field for field, key in _KEYS.items()}
_INPUTS = {"surfaces": ("surfaces", "ecg", "probe_path"), "cine": ("cine", "labels", "es_labels", "voxel_mm")}
"""Keys that belong to only one kind of anatomy."""
_SEEDS = ("anatomy_seed", "motion_seed", "mismatch_seed", "speckle_seed")
_HEADER = """\
# A synthetic scenario. It can be made again from this file: dvf-ig synth scenario --spec FILE -o DIR
# Under `options` everything may be changed; a key that is left out keeps the value of the named preset.
"""


class SpecFile(BaseModel):
    """Content of a specification file.

    Attributes:
        world: which synthetic world; `quality` belongs to the second, which also takes seed, motion, seconds
            and us_rate_hz.
        anatomy: source of the beating heart; surfaces, ecg and probe_path belong to "surfaces", cine, labels
            es_labels (FILE@PHASE; without, end-systole is tracked) and voxel_mm (of a cine whose header has
            lost it) to "cine".
        probe_calibration, image_px: file with a real probe's image calibration, and its image's columns and
            rows; both or neither.
        heart: kind of heart of the phantom.
        exam: examination as which its MR is acquired; without, isotropic 4-D MR.
        anatomy_seed, motion_seed, mismatch_seed, speckle_seed: if they differ from `seed`.
        options: changes to the preset, as deep as needed.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_: Literal["dvf_ig.scenario-spec/1"] = Field(default="dvf_ig.scenario-spec/1", alias="schema")
    world: Literal["first", "second"] = "first"
    quality: Literal["calm", "poor-image"] | None = None
    anatomy: Literal["phantom", "surfaces", "cine"] = "phantom"
    surfaces: str | None = None
    ecg: str | None = None
    probe_path: str | None = None
    cine: str | None = None
    labels: str | None = None
    es_labels: str | None = None
    voxel_mm: tuple[float, float, float] | None = None
    probe_calibration: str | None = None
    image_px: tuple[int, int] | None = None
    preset: str = "calm"
    motion: str = "paper5mm"
    seconds: float = 60.0
    seed: int = 1
    heart: str = "standard"
    exam: Literal["sax7", "sax8", "sax10", "sax+lax"] | None = None
    anatomy_seed: int | None = None
    motion_seed: int | None = None
    mismatch_seed: int | None = None
    speckle_seed: int | None = None
    us_rate_hz: float = 12.0
    mismatch_mm: float | None = None
    options: dict[str, Any] = Field(default_factory=dict)


def read_spec(path: Path) -> SpecFile:
    """Read and check a specification; unknown keys are errors.

    Raises:
        UnreadableFileError: absent, not YAML, unknown keys, or a value of the wrong kind.
    """
    document = read_yaml(path, "a scenario's specification")
    if not isinstance(document, dict):
        raise UnreadableFileError(f"{path} is not a scenario's specification; needed keys and values")
    try:
        return SpecFile.model_validate(document)
    except ValidationError as exc:
        raise UnreadableFileError(f"{path}: {_problems(exc)}") from exc


def scenario_spec(file: SpecFile) -> "ScenarioSpec":
    """Convert the file to the values of a scenario.

    Raises:
        InvalidInputError: unknown preset, motion or option, or an impossible value.
        UnreadableFileError, QualityGateError: the probe's calibration, as `read_probe`.
    """
    from data_synth import MOTIONS, PRESETS, ScenarioSpec, preset_name

    motion = next((name for name in MOTIONS if name == file.motion), None)
    if motion is None:
        raise InvalidInputError(f"there is no motion '{file.motion}'; choose from {', '.join(MOTIONS)}")
    name = preset_name(file.preset)
    changed = _merged(PRESETS[name], file.options) if file.options else None
    return ScenarioSpec(
        name,
        motion,
        file.seconds,
        file.seed,
        file.us_rate_hz,
        file.mismatch_mm,
        changed,
        _calibrated_image(file),
        _heart(file),
        _exam(file),
    )


def _exam(file: SpecFile) -> Literal["sax7", "sax8", "sax10", "sax+lax"] | None:
    if file.exam is not None and file.anatomy != "phantom":
        raise InvalidInputError(
            "--exam images the phantom's heart; leave it out, or take --anatomy phantom: the pre-operative "
            "data of a real heart are its own"
        )
    return file.exam


def _heart(file: SpecFile) -> "HeartSpec":
    """Return kind and seeds of the heart."""
    from data_synth import HEART_KINDS, HeartSpec

    kind = next((name for name in HEART_KINDS if name == file.heart), None)
    if kind is None:
        raise InvalidInputError(
            f"there is no kind of heart '{file.heart}'; choose from {', '.join(HEART_KINDS)}"
        )
    if file.anatomy != "phantom" and (kind, file.anatomy_seed, file.motion_seed) != ("standard", None, None):
        raise InvalidInputError(
            "kind, anatomy and motion of a real heart are its own; leave out --heart, --anatomy-seed and "
            "--motion-seed, or take --anatomy phantom"
        )
    return HeartSpec(kind, file.anatomy_seed, file.motion_seed, file.mismatch_seed, file.speckle_seed)


def _calibrated_image(file: SpecFile) -> "CalibratedImage | None":
    """Read the real probe that the file names, if any."""
    if file.probe_calibration is None and file.image_px is None:
        return None
    if file.probe_calibration is None or file.image_px is None:
        raise InvalidInputError(
            "a probe's calibration and the size of its image belong together; needed --probe-calibration "
            "(probe_calibration) and --image-px (image_px), which dvf-ig inspect reports for its recordings"
        )
    from data_synth import CalibratedImage
    from dvf_ig.io import read_probe

    return CalibratedImage(read_probe(file.probe_calibration), *file.image_px)


def spec_text(file: SpecFile) -> str:
    """Format YAML with every option spelt out."""
    spec = scenario_spec(file)
    options = {_KEYS.get(field, field): value for field, value in dataclasses.asdict(spec.options).items()}
    full = file.model_copy(update={"preset": spec.preset, "options": options})
    document = full.model_dump(mode="json", by_alias=True)
    inputs = set().union(*(names for kind, names in _INPUTS.items() if kind != file.anatomy))
    inputs |= {key for key in _SEEDS if document[key] is None}
    inputs |= {"world", "quality"} | ({"exam"} if file.exam is None else set())
    if file.probe_calibration is None:
        inputs |= {"probe_calibration", "image_px"}
    complete = {key: value for key, value in document.items() if key not in inputs}
    return _HEADER + yaml_text(complete, flow=None)


def _merged(preset: "Preset", options: dict[str, Any]) -> "Preset":
    """Replace some of the values of `preset`."""
    try:
        merged: Preset = _replaced(preset, options)
    except ValidationError as exc:
        raise InvalidInputError(f"the scenario's options: {_problems(exc)}") from exc
    return merged


def _replaced(value: Any, options: dict[str, Any]) -> Any:
    """Replace values of a frozen dataclass, down to the fields of its fields."""
    checked = _strict(type(value)).model_validate(options)
    new = {}
    for key, new_value in options.items():
        name = _FIELDS.get(key, key)
        old_value = getattr(value, name)
        nested = dataclasses.is_dataclass(old_value) and isinstance(new_value, dict)
        new[name] = _replaced(old_value, new_value) if nested else getattr(checked, name)
    return dataclasses.replace(value, **new)


def _strict(kind: Any) -> type[BaseModel]:
    """Build a model with the keys of a dataclass's fields, all optional, that refuses unknown ones."""
    hints = get_type_hints(kind)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(kind):
        hint: Any = hints[field.name]
        key = Field(default=None, alias=_KEYS.get(field.name, field.name))
        fields[field.name] = (_strict(hint) if dataclasses.is_dataclass(hint) else hint, key)
    return create_model(kind.__name__, __config__=ConfigDict(extra="forbid", allow_inf_nan=False), **fields)


def _problems(error: ValidationError) -> str:
    return "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()[:5])
