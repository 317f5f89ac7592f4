"""What a SESSION.yaml may say: the files of one intervention, and the fixtures that act in it.

schema: dvf_ig.session/1
preop: {model: heart.npz, mr: cine.nrrd}
ultrasound: {file: sweep.igs.mha}
ecg: edf:ecg.edf                      # leave out where the sweep holds the ECG as field data
tool: {file: tool.igs.mha}
calibration: {probe: probe.json, latency: lag.json, tip: tip.json}
start: {landmarks_mr: model.mrk.json, landmarks_tracker: patient.mrk.json}
fixtures: [{law: forbidden, depth_mm: 2.0}]

Names of files are relative to the folder of the SESSION.yaml.
"""

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from dvf_ig.core.recordings.sequence import Fan
from dvf_ig.intake.fixtures import DeviceConfig, FixtureConfig, MarginChoice, Number, RetimingName
from dvf_ig.intake.live import LiveConfig
from dvf_ig.io.yaml_config import KIND, Section

SCHEMA = "dvf_ig.session/1"
Fraction = Annotated[float, Field(strict=True, ge=0.0, lt=1.0)]
Pixel = Annotated[float, Field(strict=True, ge=-1e6, le=1e6)]
Whole = Annotated[int, Field(strict=True)]
Text = Annotated[str, Field(strict=True, min_length=1)]
FileName = Text


def _by_kind(needed: str, **kinds: type | tuple[type, ...]) -> Discriminator:
    """Tells the kinds of a value apart by their types; `needed` is what a user reads where it is none."""

    def kind(value: Any) -> str | None:
        return next((KIND + name for name, types in kinds.items() if isinstance(value, types)), None)

    return Discriminator(kind, custom_error_type="kind", custom_error_message=f"needed {needed}")


class FanConfig(Section):
    """The insonified sector, px and rad."""

    apex_px: tuple[Pixel, Pixel]
    start_px: Pixel
    stop_px: Pixel
    half_angle_rad: Annotated[float, Field(strict=True, gt=0.0, le=3.2)]

    def fan(self) -> Fan:
        """The sector itself."""
        return Fan(**self.model_dump())


class PreopConfig(Section):
    """The pre-operative heart: a model, or what one is built from.

    Labels of every phase are a 4-D image; a 3-D one holds those of `ed_phase`, and `mr` tells the motion.
    """

    model: FileName | None = None
    mr: FileName | None = None
    labels: FileName | None = None
    ed_phase: Annotated[int, Field(strict=True, ge=0)] = 0
    label_names: dict[int, str] = Field(default_factory=dict)
    organ_labels: tuple[Whole, ...] = ()
    cavity_labels: tuple[Whole, ...] = ()
    surfaces_folder: FileName | None = None
    surfaces: tuple[str, ...] = ()
    surface: str = "EPICARDIAL"
    timing: FileName | None = None

    @model_validator(mode="after")
    def _enough(self) -> "PreopConfig":
        if self.model is None and self.labels is None and self.surfaces_folder is None:
            raise ValueError(
                "needed model, or labels (with mr where they are of end-diastole alone), or surfaces_folder"
            )
        if self.surfaces and self.surfaces_folder is None:
            raise ValueError("surfaces names surfaces; give surfaces_folder, too")
        return self


class FileSection(Section):
    """A section that its file's name may stand for."""

    file: FileName

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, given: Any) -> Any:
        return {"file": given} if isinstance(given, str) else given


class UltrasoundConfig(FileSection):
    """Tracked images; names of sensors as the recording has them."""

    probe_name: Text | None = None
    reference_name: Text | None = None
    fan: FanConfig | None = None


class EcgConfig(FileSection):
    """An ECG or a trigger as `gate` takes it, for example `edf:FILE`.

    `rate_hz` is of a table without times; `start_s` is when the first sample was taken on the tracker's
    clock, in place of what the file says; `delay_s` says how long after the R peak a trigger fires.
    """

    rate_hz: Annotated[float, Field(strict=True, ge=1.0, le=100_000.0)] | None = None
    start_s: Number | None = None
    delay_s: Number | None = None


class ToolConfig(FileSection):
    """Poses of the tool; its name as the recording has it."""

    name: Text | None = None


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


class CalibrationDraft(Section):
    """The calibrations that there are so far."""

    probe: ProbeSource | None = None
    latency: LatencySource | None = None
    tip: TipSource | None = None


class CalibrationConfig(CalibrationDraft):
    """Each calibration: the file that `calibrate` wrote, or its recording; the latency also as seconds."""

    probe: ProbeSource
    latency: LatencySource


class StartConfig(Section):
    """Where registration starts; what is given beside the transform checks the result."""

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
            raise ValueError("touched_phase is of points that were touched; give touched, too")
        return self


class SessionDraft(Section):
    """A `SessionConfig` of which only the ultrasound is sure to be there.

    Attributes:
        patient_id: of the model unless given; of images, their name.
        ecg: None where the ultrasound sequence holds it as field data.
        tool: None takes the tool tracked in the ultrasound sequence, if there is one.
        fixtures, cap_n, retiming, margin, device: as in a file of `--fixtures`.
        truth: folder of a synthetic scenario's truth, to be scored against.
        live: who sends what in a live session; recordings do not need it.
    """

    schema_: Literal["dvf_ig.session/1"] = Field(default="dvf_ig.session/1", alias="schema")
    name: Text | None = None
    preset: str = "recorded"
    seed: Whole | None = None
    patient_id: Text | None = None
    preop: PreopConfig | None = None
    ultrasound: UltrasoundConfig
    ecg: EcgConfig | None = None
    tool: ToolConfig | None = None
    calibration: CalibrationDraft = CalibrationDraft()
    start: StartConfig = StartConfig()
    fixtures: FixtureSource | None = None
    cap_n: Number | None = None
    retiming: RetimingName | None = None
    margin: MarginChoice | None = None
    device: DeviceConfig | None = None
    truth: FileName | None = None
    live: LiveConfig | None = None


class SessionConfig(SessionDraft):
    """The content of a SESSION.yaml: a draft that has all that a registration needs."""

    preop: PreopConfig
    calibration: CalibrationConfig


class LiveSessionConfig(SessionConfig):
    """The same of a live session, which needs no recordings: ECG, tool and images are sent."""

    ultrasound: UltrasoundConfig | None = None  # type: ignore[assignment]
    live: LiveConfig
