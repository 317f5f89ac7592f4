"""The content of a session.yaml: the files of one intervention, and the fixtures that act in it.

schema: dvf_ig.session/1
preop: {model: heart.npz, mr: cine.nrrd}
ultrasound: {file: sweep.igs.mha}
ecg: edf:ecg.edf                      # leave out where the sweep holds the ECG as field data
tool: {file: tool.igs.mha}
calibration: {probe: probe.json, latency: lag.json, tip: tip.json}
start: {landmarks_mr: model.mrk.json, landmarks_tracker: patient.mrk.json}
fixtures: [{law: forbidden, depth_mm: 2.0}]

Names of files are relative to the folder of the session.yaml. The sections say which values are valid, `KEYS`
what the comments of a session.yaml, the guide's table and the options of `dvf-ig config init` say of them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, Discriminator, Field, Tag, field_validator, model_validator

from dvf_ig.core.recordings.sequence import Fan
from dvf_ig.io.ecg.trigger import split_ecg
from dvf_ig.io.image.gated_volume import gated_volume_files
from dvf_ig.io.respiration import split_respiration
from dvf_ig.io.truth import FILES as TRUTH_FILES
from dvf_ig.io.yaml_config import KIND, Section

from .fixtures import DeviceConfig, FixtureConfig, MarginChoice, Number, RetimingName, ToolShapeConfig
from .live import LiveConfig

SCHEMA = "dvf_ig.session/1"
Fraction = Annotated[float, Field(strict=True, ge=0.0, lt=1.0)]
Pixel = Annotated[float, Field(strict=True, ge=-1e6, le=1e6)]
Whole = Annotated[int, Field(strict=True)]
Text = Annotated[str, Field(strict=True, min_length=1)]
FileName = Text


class Form(StrEnum):
    """How the value of a key is given on a command line, and whether it names files."""

    TEXT = "text"
    NUMBER = "number"
    WHOLES = "whole numbers"
    FAN = "sector"
    FILE = "file"
    SOURCE = "file or seconds"
    ECG = "ecg"
    BREATH = "breathing"
    PAIR = "two files, for this key and the next"
    POINTS = "file, or file and phase"
    VOLUMES = "files, each with a phase or a time"


TEXT, NUMBER, WHOLES, FAN, FILE, SOURCE, ECG, BREATH, PAIR, POINTS, VOLUMES = Form


@dataclass(frozen=True, slots=True)
class Key:
    """Description of a key, and the option of `config init` that sets it.

    Attributes:
        holds: what it says.
        unless: what holds if it is left out.
        example: value in the comment that `config init` writes; "" writes none.
        option: its spellings and the placeholder of its value, for example "--mr --cine CINE"; "" has none.
        goes_with: keys of its section of which one has to be given as well.
    """

    holds: str
    unless: str = ""
    example: str = ""
    form: Form = TEXT
    option: str = ""
    goes_with: tuple[str, ...] = ()

    @property
    def options(self) -> tuple[str, ...]:
        """Spellings of the option."""
        return tuple(word for word in self.option.split() if word.startswith("--"))

    @property
    def metavar(self) -> str:
        """Placeholder of the option's value."""
        return " ".join(word for word in self.option.split() if not word.startswith("--"))

    @property
    def note(self) -> str:
        """Content of the key, and what holds without it."""
        return f"{self.holds}; else {self.unless}" if self.unless else self.holds


HEART = ("model", "labels", "surfaces_folder")
# fmt: off
KEYS: dict[str, Key] = {
    "name": Key("title of a synthetic scenario"),
    "preset": Key("which synthetic preset, or recorded"),
    "seed": Key("of a synthetic scenario"),
    "patient_id": Key("whose heart; a model of another patient is refused",
                      "the model's, or the image's name", "P-17", TEXT, "--patient ID"),
    "preop.model": Key("what `dvf-ig model build` wrote; alone it is enough to register, by its blood",
                       "a model is built, and kept in the cache", "heart.npz", FILE, "--model FILE"),
    "preop.mr": Key("4-D MR or CT that ultrasound is compared with; with it a pose is more certain",
                    "the model's blood", "cine.nrrd", FILE, "--mr --cine CINE", HEART),
    "preop.views": Key("long-axis cines of the examination whose short-axis stack `mr` is, one slice each",
                       "the base's motion is not known; a pose is used only if the sweep images enough of "
                       "the stack to bound its error by 8 mm", "[lax_4ch.nrrd]", FILE),
    "preop.labels": Key("4-D labels, or 3-D ones of `ed_phase` with `mr`", "", "labels.nii.gz", FILE,
                        "--labels FILE"),
    "preop.ed_phase": Key("phase of `mr` that 3-D labels belong to", "0", "0"),
    "preop.organ_labels": Key("values inside the protected surface", "all but 0", "[1, 2]", WHOLES,
                              "--organ 1,2,5", ("labels",)),
    "preop.cavity_labels": Key("values of blood, the left ventricle's first: ultrasound shows its border",
                               "those named blood or cavity", "[2]", WHOLES, "--cavity 2,4", ("labels",)),
    "preop.label_names": Key("names of labels by value", "", "{1: wall, 2: lv_blood}"),
    "preop.surfaces_folder": Key("meshes NAME_0.vtp, NAME_1.vtp, …, one a phase", "", "surfaces", FILE,
                                 "--surfaces DIR"),
    "preop.surfaces": Key("names of the surfaces to read", "all", "[EPICARDIAL]"),
    "preop.surface": Key("the surface to protect", "EPICARDIAL", "EPICARDIAL"),
    "preop.timing": Key('JSON `{"fractions": [0.0, 0.05, …], "rr_s": 0.86}`: phases in the cycle',
                        "`timing.json` next to the images, or phase i at i/N", "timing.json", FILE),
    "ultrasound.file": Key("PLUS sequence: images with the probe's pose, stamped by the video clock",
                           "`volumes`", "sweep.igs.mha", FILE, "--us SWEEP"),
    "ultrasound.volumes": Key("gated 3-D images in the tracker's LPS: FILE@PHASE of the RR interval, or "
                              "FILE=SECONDS on the ECG's clock; a 4-D file with times is split", "`file`",
                              "[ed.nrrd@0.0, es.nrrd@0.35]", VOLUMES, "--us-volume FILE@PHASE|FILE=SECONDS"),
    "ultrasound.probe_name": Key("what the recording calls the probe's marker", "Probe", "Probe", TEXT,
                                 "--probe-name NAME"),
    "ultrasound.reference_name": Key("what its poses are relative to", "Reference if recorded, or Tracker",
                                     "Reference", TEXT, "--reference-name NAME"),
    "ultrasound.fan": Key("insonified sector, px and rad; give it where the scanner writes on the image",
                          "found in the images",
                          "{apex_px: [128, 10], start_px: 20, stop_px: 240, half_angle_rad: 0.6}", FAN,
                          "--fan COLUMN,ROW,START,STOP,ANGLE"),
    "ecg.file": Key("edf:FILE, wfdb:RECORD, csv:FILE, plus:SEQUENCE or trigger:FILE, as `gate` takes it",
                    "the ECG that PLUS recorded in `ultrasound.file`", "edf:ecg.edf", ECG, "--ecg edf:FILE"),
    "ecg.rate_hz": Key("of a recording that states none, Hz", "", "250", NUMBER, "--rate HZ", ("file",)),
    "ecg.lead": Key("leads to use, separated by commas", "all that are named as an ECG", "II", TEXT,
                    "--lead NAME", ("file",)),
    "ecg.start_s": Key("when another recorder took its first sample, s on the tracker's clock",
                       "the file's own times", "12.5", NUMBER, "--ecg-start SECONDS", ("file",)),
    "ecg.delay_s": Key("of a trigger: how long after the R peak it fires, s", "as its file says", "0.02"),
    "tool.file": Key("sequence with the tool's poses", "the only other tool in `ultrasound.file`",
                     "tool.igs.mha", FILE, "--tool FILE"),
    "tool.name": Key("what the recording calls it", "the only one", "Stylus", TEXT, "--tool-name NAME"),
    "tool.diameter_mm": Key("thickness of tip and shaft, which walls are kept away from", "a point", "5.0"),
    "tool.shaft_mm": Key("length above the tip that walls act on as well", "the tip alone", "60"),
    "tool.axis": Key("from tip to handle in the tool's own frame, for a shaft", "through the fulcrum",
                     "[0, 0, -1]"),
    "tool.fulcrum": Key("trocar in the tracker's frame, mm, and length from hand to tip; a device is the "
                        "hand", "a device moves the tip", "{point_mm: [10, 20, 30], length_mm: 350}"),
    "respiration.file": Key("what follows the breath: csv:FILE#CHANNEL, wfdb:RECORD#CHANNEL or marker:FILE",
                            "no breathing (high-frequency ventilation)", "csv:icu.csv#pressure", BREATH,
                            "--respiration csv:FILE#CHANNEL"),
    "respiration.rate_hz": Key("of a table without times, or of times without a unit, Hz", "", "25", NUMBER,
                               "--respiration-rate HZ", ("file",)),
    "calibration.probe": Key("probe_from_image, mm per pixel", "", "probe.json", FILE, "--probe FILE"),
    "calibration.latency": Key("file, or s: time of tracker = time of video + latency", "", "latency.json",
                               SOURCE, "--latency --lag-s FILE|SECONDS"),
    "calibration.tip": Key("of the tool, mm in its own frame; a force needs it", "", "tip.json", FILE,
                           "--tip FILE"),
    "calibration.device": Key("place of a haptic device, for `serve --device`", "", "device.json", FILE),
    "start.transform": Key("coarse mr_from_tracker, within 10 mm or so: ITK .tfm or .h5", "landmarks",
                           "start.tfm", FILE, "--start FILE"),
    "start.landmarks_mr": Key("three points or more, marked on the images or model", "touched points",
                              "model.mrk.json", PAIR, "--landmarks --start-landmarks MR TRACKER"),
    "start.landmarks_tracker": Key("the same points touched on the patient, mm", "", "patient.mrk.json",
                                   FILE),
    "start.touched": Key("40 points, at least 20, all over the heart's surface: x, y, z (mm, tracker)", "",
                         "touched.csv", POINTS, "--touched POINTS"),
    "start.touched_phase": Key("when in the cycle they were touched, 0 to below 1", "end-diastole", "0.0"),
    "fixtures": Key("what acts on the tool: a list, or a file of it", "one forbidden region",
                    "[{law: forbidden, gamma: 1.0, depth_mm: 0.0, cap_n: 0.6}]", FILE),
    "cap_n": Key("largest force of all fixtures together, N", "the largest of them"),
    "retiming": Key("how the beat is mapped to the model's cycle: two-segment, uniform", "two-segment",
                    "two-segment"),
    "margin": Key("what fixtures are widened by: off, fixed (2 mm), a number of mm, adaptive", "off", "off"),
    "device": Key("what renders forces above 4 N", "", "{name: omega.3, continuous_force_n: 12}"),
    "truth": Key("folder of a synthetic scenario's truth"),
    "live": Key("what PLUS or 3D Slicer sends to `dvf-ig serve` (guide/live.md)", "",
                "{probe: ProbeToTracker, tool: ToolToTracker, image: Image_Tracker, "
                "ecg: {field: EcgData, rate_hz: 500}}"),
}
# fmt: on
"""Every key of a session.yaml by its dotted name, in the order of the file."""


def _by_kind(needed: str, **kinds: type | tuple[type, ...]) -> Discriminator:
    """Discriminate the kinds of a value by their types; `needed` is the message for a value of no kind."""

    def kind(value: Any) -> str | None:
        return next((KIND + name for name, types in kinds.items() if isinstance(value, types)), None)

    return Discriminator(kind, custom_error_type="kind", custom_error_message=f"needed {needed}")


class FanConfig(Section):
    """The insonified sector, px and rad."""

    apex_px: tuple[Pixel, Pixel]
    start_px: Pixel
    stop_px: Pixel
    half_angle_rad: Annotated[float, Field(strict=True, gt=0.0, le=3.2)]

    @classmethod
    def of(cls, fan: Fan) -> "FanConfig":
        """The section that states a sector."""
        return cls(
            apex_px=(float(fan.apex_px[0]), float(fan.apex_px[1])),
            start_px=float(fan.start_px),
            stop_px=float(fan.stop_px),
            half_angle_rad=float(fan.half_angle_rad),
        )

    def fan(self) -> Fan:
        """The sector itself."""
        return Fan(**self.model_dump())


class PreopConfig(Section):
    """The pre-operative heart, in frame mr (LPS, mm): a model, or what one is built from."""

    model: FileName | None = None
    mr: FileName | None = None
    views: tuple[FileName, ...] = ()
    labels: FileName | None = None
    ed_phase: Annotated[int, Field(strict=True, ge=0)] = 0
    organ_labels: tuple[Whole, ...] = ()
    cavity_labels: tuple[Whole, ...] = ()
    label_names: dict[int, str] = Field(default_factory=dict)
    surfaces_folder: FileName | None = None
    surfaces: tuple[str, ...] = ()
    surface: str = "EPICARDIAL"
    timing: FileName | None = None

    @model_validator(mode="after")
    def _enough(self) -> "PreopConfig":
        if self.model is None and self.labels is None and self.surfaces_folder is None:
            raise ValueError(
                "needed model, or labels (with mr if they are of end-diastole alone), or surfaces_folder"
            )
        if self.surfaces and self.surfaces_folder is None:
            raise ValueError("surfaces names surfaces; also give surfaces_folder")
        return self


class FileSection(Section):
    """A section that may be given as the name of its file alone."""

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, given: Any) -> Any:
        return {"file": given} if isinstance(given, str) else given


class UltrasoundConfig(FileSection):
    """Tracked images with poses of the probe (mm), on the clock of the video (s); or gated 3-D images."""

    file: FileName | None = None
    volumes: tuple[Text, ...] = ()
    probe_name: Text | None = None
    reference_name: Text | None = None
    fan: FanConfig | None = None

    @field_validator("volumes")
    @classmethod
    def _placed(cls, given: tuple[str, ...]) -> tuple[str, ...]:
        gated_volume_files(given)
        return given

    @model_validator(mode="after")
    def _something(self) -> "UltrasoundConfig":
        if self.file is None and not self.volumes:
            raise ValueError("needed file, a tracked sweep, or volumes, gated 3-D images")
        return self


class EcgConfig(FileSection):
    """ECG on the clock of the tracker (s), or the pulses of a trigger in its place."""

    file: FileName
    rate_hz: Annotated[float, Field(strict=True, ge=1.0, le=100_000.0)] | None = None
    lead: Text | None = None
    start_s: Number | None = None
    delay_s: Number | None = None


class _ToolPoses(FileSection):
    """Poses of the tool (mm) on the clock of the tracker (s)."""

    file: FileName | None = None
    name: Text | None = None

    @model_validator(mode="after")
    def _named_in_a_file(self) -> Self:
        if self.name is not None and self.file is None:
            raise ValueError("a name needs the file in which it is recorded")
        return self


class ToolConfig(ToolShapeConfig, _ToolPoses):
    """Shape of the tool, and its poses, which a replay needs."""


class RespirationConfig(FileSection):
    """What follows the breath, on the clock of the tracker (s); without it no breathing is expected."""

    file: FileName
    rate_hz: Annotated[float, Field(strict=True, ge=2.0, le=100_000.0)] | None = None


class NWireConfig(Section):
    """An N-wire sweep with its wire points in a PLUS result (`calibrate probe` finds them in images)."""

    phantom: Literal["nwire"]
    file: FileName
    device_set: FileName
    points: FileName


class TargetConfig(Section):
    """A sweep of a cross-wire or a wall, with a table of its points in every image."""

    phantom: Literal["cross-wire", "wall"]
    file: FileName
    points: FileName


class LatencyConfig(Section):
    """A water-tank sweep with the line of its floor in every image (`calibrate latency` finds it)."""

    tracker: FileName
    video: FileName
    lines: FileName


class PivotConfig(Section):
    """Poses of the tool while it pivots about its tip."""

    pivot: FileName


def _probe_kind(value: Any) -> str | None:
    if isinstance(value, str):
        return f"{KIND}file"
    phantom = value.get("phantom") if isinstance(value, dict) else getattr(value, "phantom", None)
    return {"nwire": f"{KIND}nwire", "cross-wire": f"{KIND}target", "wall": f"{KIND}target"}.get(
        phantom or ""
    )


ProbeSource = Annotated[
    Annotated[FileName, Tag(f"{KIND}file")]
    | Annotated[NWireConfig, Tag(f"{KIND}nwire")]
    | Annotated[TargetConfig, Tag(f"{KIND}target")],
    Discriminator(
        _probe_kind,
        custom_error_type="kind",
        custom_error_message="needed the file of a calibration, or a sweep with its phantom: nwire, "
        "cross-wire or wall",
    ),
]
LatencySource = Annotated[
    Annotated[FileName, Tag(f"{KIND}file")]
    | Annotated[Number, Tag(f"{KIND}seconds")]
    | Annotated[LatencyConfig, Tag(f"{KIND}sweep")],
    _by_kind(
        "a number (s), the file of a calibration, or a sweep with tracker and video",
        file=str,
        seconds=(int, float),
        sweep=(dict, LatencyConfig),
    ),
]
TipSource = Annotated[
    Annotated[FileName, Tag(f"{KIND}file")] | Annotated[PivotConfig, Tag(f"{KIND}poses")],
    _by_kind("the file of a calibration, or poses as pivot: FILE", file=str, poses=(dict, PivotConfig)),
]
FixtureSource = Annotated[
    Annotated[FileName, Tag(f"{KIND}file")] | Annotated[tuple[FixtureConfig, ...], Tag(f"{KIND}list")],
    _by_kind("a list of fixtures, or the name of a file", file=str, list=(list, tuple)),
]


class CalibrationConfig(Section):
    """Calibrations: what dvf-ig calibrate … -o FILE wrote (a probe's and a tip's also as PLUS XML)."""

    probe: ProbeSource | None = None
    latency: LatencySource | None = None
    tip: TipSource | None = None
    device: FileName | None = None


class StartConfig(Section):
    """Where registration starts: the first of three; the others, if given, check the result."""

    transform: FileName | None = None
    landmarks_mr: FileName | None = None
    landmarks_tracker: FileName | None = None
    touched: FileName | None = None
    touched_phase: Fraction | None = None

    @model_validator(mode="after")
    def _pairs(self) -> "StartConfig":
        if (self.landmarks_mr is None) != (self.landmarks_tracker is None):
            raise ValueError("landmarks need both landmarks_mr and landmarks_tracker")
        if self.touched_phase is not None and self.touched is None:
            raise ValueError("touched_phase belongs to points that were touched; also give touched")
        return self


class SessionConfig(Section):
    """The content of a session.yaml, of which any part may still be missing (`intake.parts` says which)."""

    schema_: Literal["dvf_ig.session/1"] = Field(default="dvf_ig.session/1", alias="schema")
    name: Text | None = None
    preset: str = "recorded"
    seed: Whole | None = None
    patient_id: Text | None = None
    preop: PreopConfig | None = None
    ultrasound: UltrasoundConfig | None = None
    ecg: EcgConfig | None = None
    tool: ToolConfig | None = None
    respiration: RespirationConfig | None = None
    calibration: CalibrationConfig = CalibrationConfig()
    start: StartConfig = StartConfig()
    fixtures: FixtureSource | None = None
    cap_n: Number | None = None
    retiming: RetimingName | None = None
    margin: MarginChoice | None = None
    device: DeviceConfig | None = None
    truth: FileName | None = None
    live: LiveConfig | None = None


def option_names() -> dict[str, str]:
    """The option of `config init` by the key that it sets."""
    return {name: key.options[0] for name, key in KEYS.items() if key.option}


def named_files(section: BaseModel, within: str = "") -> Iterator[tuple[str, str]]:
    """(key, name) of every file and folder that a configuration names; an ECG's without its prefix.

    A calibration's recording counts file by file.
    """
    for field in type(section).model_fields:
        value, name = getattr(section, field), f"{within}{field}"
        key = KEYS.get(name)
        if isinstance(value, Section) and name not in ("live", "device"):
            yield from named_files(value, f"{name}.")
        elif name == "truth" and value is not None:
            yield from ((name, f"{value}/{file}") for file in TRUTH_FILES)
        elif key is None and isinstance(value, str) and field not in ("phantom", "schema_"):
            yield name, value
        elif key is not None and value:
            yield from ((name, file) for file in _files_in(value, key.form))


def _files_in(value: Any, form: Form) -> tuple[str, ...]:
    if form is VOLUMES:
        return tuple(str(file.path) for file in gated_volume_files(value))
    if form is ECG:
        return (split_ecg(value).name,)
    if form is BREATH:
        return (split_respiration(value).name,)
    if form is FILE and isinstance(value, tuple):
        return tuple(name for name in value if isinstance(name, str))
    return (value,) if form in (FILE, SOURCE, PAIR, POINTS) and isinstance(value, str) else ()


def is_there(path: Path, key: str) -> bool:
    """Whether a named file exists; a WFDB record is named without its ending."""
    return path.exists() or (
        key in ("ecg.file", "respiration.file") and path.with_name(f"{path.name}.hea").is_file()
    )


def key_table() -> str:
    """Markdown of every key, as the guide shows it."""
    rows = [f"| `{name}` | {key.holds} | {key.unless} |" for name, key in KEYS.items()]
    return "\n".join(["| key | holds | left out |", "|---|---|---|", *rows])
