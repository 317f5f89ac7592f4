"""Topics of a session log, and its document as JSON: calibrations, start, heart; every digit kept."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from dvf_ig.core import DvfModel, FloatArray, ImageMap, Preop, Rigid, Scenario, UnreadableFileError
from dvf_ig.core.space.points import Landmarks, Points
from dvf_ig.core.timing.trigger import TriggerTimes
from dvf_ig.guidance import Hazard, Status, SupervisorState
from dvf_ig.intake.parts import SessionFiles
from dvf_ig.intake.scenario import ScenarioPreop
from dvf_ig.intake.scenario_write import write_preop
from dvf_ig.intake.schema import FanConfig, PreopConfig
from dvf_ig.io import limits
from dvf_ig.io.model.model_file import model_bytes
from dvf_ig.io.plus.names import split_transform
from dvf_ig.io.ros import messages as ros
from dvf_ig.io.ros.log_file import LogWriter
from dvf_ig.io.writing.place import scratch_folder
from dvf_ig.io.yaml_config import Section, validated

DOCUMENT = "session.json"
ECG, IMAGE, TRIGGER = "/ecg", "/ultrasound/image", "/trigger"
EXACT_FRAME, EXACT_TOOL, RESPIRATION = "/exact/ultrasound", "/exact/tool", "/exact/respiration"
STREAMS = {
    ECG: ros.ARRAY,
    TRIGGER: ros.ARRAY,
    IMAGE: ros.IMAGE,
    EXACT_FRAME: ros.ARRAY,
    EXACT_TOOL: ros.ARRAY,
    RESPIRATION: ros.ARRAY,
}
"""Topics that a replay reads, with the type of each."""
POSE_LABEL = "t_s, valid, rotation (9, row-major), translation_mm (3): tracker_from_{}"
IMAGE_LABEL = ", then whether the image is valid"
LEVELS = {
    SupervisorState.OK: 0,
    SupervisorState.DEGRADED: 1,
    SupervisorState.FADE: 2,
    SupervisorState.LATCHED: 2,
}
"""Levels of diagnostics: OK, warning, error."""
GUIDANCE = (
    *("phi", "model_phase", "rr_s", "distance_mm", "pose_age_s"),
    *("breath_phase", "breath_mm", "breath_state"),
)
"""Columns of ticks.csv that are logged as numbers; NaN for missing values, `BreathState` or -1."""
STATUS_EVERY_S = 1.0


def exact_pose(t_s: float, valid: bool, rotation: FloatArray, translation_mm: FloatArray) -> FloatArray:
    return np.concatenate([[t_s, float(valid)], rotation.ravel(), translation_mm])


def status_message(t_s: float, status: int, supervisor: int, hazards: int) -> ros.Message:
    state = SupervisorState(supervisor)
    active = "|".join(one.name.lower() for one in Hazard(hazards) if one.name)
    values = {"status": Status(status).name.lower(), "hazards": active}
    return ros.diagnostics(t_s, LEVELS[state], "supervisor", state.name.lower(), values)


SCHEMA = "dvf_ig.log/1"
Length = Annotated[float, Field(ge=-limits.LENGTH_MM, le=limits.LENGTH_MM)]
Time = Annotated[float, Field(ge=-limits.TIME_S, le=limits.TIME_S)]
Row = tuple[Length, Length, Length]


class RigidEntry(Section):
    """Rigid transform, mm."""

    target: str
    source: str
    rotation: tuple[Row, Row, Row]
    translation_mm: Row

    @classmethod
    def of(cls, rigid: Rigid) -> "RigidEntry":
        return cls(
            target=rigid.target,
            source=rigid.source,
            rotation=rigid.rotation.tolist(),
            translation_mm=rigid.translation_mm.tolist(),
        )

    def rigid(self) -> Rigid:
        return Rigid(self.target, self.source, np.array(self.rotation), np.array(self.translation_mm))


class ImageEntry(Section):
    """Image calibration, probe_from_image."""

    rigid: RigidEntry
    scale_mm_per_px: tuple[Length, Length]
    shear_deg: Annotated[float, Field(gt=-90.0, lt=90.0)]

    @classmethod
    def of(cls, image: ImageMap) -> "ImageEntry":
        rigid, scale = RigidEntry.of(image.rigid), image.scale_mm_per_px.tolist()
        return cls(rigid=rigid, scale_mm_per_px=scale, shear_deg=image.shear_deg)

    def image(self) -> ImageMap:
        return ImageMap(self.rigid.rigid(), np.array(self.scale_mm_per_px), self.shear_deg)


class PointsEntry(Section):
    """Points, mm, with their names if they have any."""

    frame: str
    names: tuple[str, ...] = ()
    xyz_mm: tuple[Row, ...]

    @classmethod
    def of(cls, values: Landmarks | Points) -> "PointsEntry":
        points, names = (values.points, values.names) if isinstance(values, Landmarks) else (values, ())
        return cls(frame=points.frame, names=names, xyz_mm=points.xyz_mm.tolist())

    def points(self) -> Points:
        return Points(self.frame, np.array(self.xyz_mm).reshape(-1, 3))

    def landmarks(self) -> Landmarks:
        return Landmarks(self.names, self.points())


class BeatsEntry(Section):
    """Format of the stream of heart beats: ECG samples, or pulses of a trigger."""

    kind: Literal["ecg", "trigger"]
    rate_hz: float | None = None
    start_s: Time | None = None
    leads: tuple[str, ...] = ()
    unit: str = "mV"
    delay_s: Time = 0.0


class SessionDocument(Section):
    """Content of `session.json`."""

    schema_: Literal["dvf_ig.log/1"] = Field(default="dvf_ig.log/1", alias="schema")
    name: str
    preset: str
    patient_id: str
    tracked_against: str
    beats: BeatsEntry
    has_timestamps: bool
    orientation: str
    fan: FanConfig | None
    probe_from_image: ImageEntry
    lag_s: Time
    tip: PointsEntry
    start: RigidEntry | None
    landmarks_mr: PointsEntry | None
    landmarks_tracker: PointsEntry | None
    touched: PointsEntry | None
    touched_phase: Annotated[float, Field(ge=0.0, lt=1.0)] | None
    preop: PreopConfig
    respiration: str | None = None
    """Name of what follows the breath; None if nothing does."""


def document_of(scenario: Scenario, image: ImageMap, lag_s: float, tip: Points, preop: PreopConfig) -> bytes:
    """Encode a recorded session with its calibrations in use as JSON."""
    ecg, sequence = scenario.ecg, scenario.ultrasound
    beats = (
        BeatsEntry(kind="trigger", delay_s=ecg.delay_s)
        if isinstance(ecg, TriggerTimes)
        else BeatsEntry(kind="ecg", rate_hz=ecg.rate_hz, start_s=ecg.start_s, leads=ecg.leads, unit=ecg.unit)
    )
    return _json(
        name=scenario.name,
        preset=scenario.preset,
        tracked_against=scenario.tracked_against,
        beats=beats,
        has_timestamps=sequence.has_timestamps,
        orientation=sequence.orientation,
        preop=preop,
        respiration=None if scenario.respiration is None else scenario.respiration.name,
        **_of_patient(SessionFiles.of(scenario), image, lag_s, tip),
    )


def document_of_live(
    files: SessionFiles, image: ImageMap, lag_s: float, tip: Points, preop: PreopConfig
) -> bytes:
    """JSON of a live session before its first event: the ECG's leads and its beginning come with it.

    Raises:
        InvalidInputError: the session has no heart, or does not say who sends what.
    """
    live = files.required_live
    reference = split_transform(live.probe) if live.reference is None else split_transform(live.reference)
    against = "tracker" if reference is None else reference[0 if live.reference is None else 1]
    return _json(
        name=files.heart.patient_id,
        preset="recorded",
        tracked_against=against,
        beats=BeatsEntry(kind="ecg", rate_hz=live.ecg.rate_hz),
        has_timestamps=True,
        orientation=live.used_orientation,
        preop=preop,
        respiration=None if live.respiration is None else "breathing",
        **_of_patient(files, image, lag_s, tip),
    )


def _json(**fields: Any) -> bytes:
    document = SessionDocument(**fields)
    return json.dumps(document.model_dump(mode="json", by_alias=True), indent=1).encode()


def _of_patient(files: SessionFiles, image: ImageMap, lag_s: float, tip: Points) -> dict[str, Any]:
    """Fields that a recording and a live session have in common."""
    fan, start = files.fan, files.start
    return {
        "patient_id": files.heart.patient_id,
        "fan": None if fan is None else FanConfig.of(fan),
        "probe_from_image": ImageEntry.of(image),
        "lag_s": lag_s,
        "tip": PointsEntry.of(tip),
        "start": None if start.start is None else RigidEntry.of(start.start),
        "landmarks_mr": _points(start.landmarks_mr),
        "landmarks_tracker": _points(start.landmarks_tracker),
        "touched": _points(start.touched),
        "touched_phase": start.touched_phase,
    }


def _points(values: Landmarks | Points | None) -> PointsEntry | None:
    return None if values is None else PointsEntry.of(values)


def read_document(data: bytes, path: Path) -> SessionDocument:
    """Parse the document of a log.

    Raises:
        UnreadableFileError: not JSON, or not a session document.
    """
    try:
        document: Any = json.loads(data)
    except (ValueError, RecursionError) as exc:
        raise UnreadableFileError(f"{path}: its session.json is damaged ({exc})") from exc
    return validated(SessionDocument, document, path)


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
