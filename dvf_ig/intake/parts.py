"""The parts of a session: one table of what each is, what reads it, what it is for, and what is said of it.

A new part is a row and a field of `SessionFiles` here, its section and keys in `intake.schema`, and a field
of `Scenario`. `PARTS` are read in their order: a part may use those above it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvf_ig.core import DvfModel, Fan, ImageMap, InvalidInputError, Points, PoseStream, Rigid, TriggerTimes
from dvf_ig.core.recordings.phantom import NWireRecording, TargetRecording
from dvf_ig.core.recordings.scenario import LatencyRecording, Preop, Scenario, ScenarioTruth
from dvf_ig.core.recordings.signal import Respiration, Signal
from dvf_ig.io import GatedVolumeFile, ProbeNames, gated_volume_files, read_gated_volumes, sequence_volumes
from dvf_ig.io.respiration import read_respiration, split_respiration

from . import contents, readers
from .fixtures import RetimingName
from .live import LiveConfig
from .preop import PreopFiles, read_preop
from .problems import Problem, ProblemList, Use, concerning
from .schema import SessionConfig

if TYPE_CHECKING:
    from dvf_ig.guidance import FixtureSet

    from .live_record import LiveRecord


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationSources:
    """Each calibration, or the recording that it is made from."""

    probe: ImageMap | NWireRecording | TargetRecording
    latency: float | LatencyRecording
    tip: Points | PoseStream | None


@dataclass(frozen=True, slots=True, eq=False)
class SessionFiles:
    """The parts of a session that were read; None if a part is not named, or cannot be read.

    Poses have the names that the recording gives them; calibrations those of a scenario.

    Attributes:
        volumes: gated 3-D ultrasound by its files, in place of a sweep.
        device: tracker_from_device of a haptic device.
        fixtures, retiming: None if the configuration does not say.
        live: who sends what in a live session.
        folder: where names of files begin.
        named: every file by the key that names it.
        tracked_against: of poses that are already renamed, what the recording called the tracker.
        record: of a live session, what repeats it.
    """

    preop: PreopFiles | None = None
    sweep: readers.Sweep | None = None
    volumes: tuple[GatedVolumeFile, ...] = ()
    fan: Fan | None = None
    ecg: Signal | TriggerTimes | None = None
    tool: PoseStream | None = None
    respiration: Respiration | None = None
    probe: ImageMap | NWireRecording | TargetRecording | None = None
    latency: float | LatencyRecording | None = None
    tip: Points | PoseStream | None = None
    device: Rigid | None = None
    start: readers.StartFiles = field(default_factory=readers.StartFiles)
    fixtures: "FixtureSet | None" = None
    retiming: RetimingName | None = None
    truth: ScenarioTruth | None = None
    live: LiveConfig | None = None
    name: str | None = None
    preset: str = "recorded"
    seed: int | None = None
    tracked_against: str | None = None
    folder: Path = Path()
    named: Mapping[str, Path] = field(default_factory=dict)
    record: "LiveRecord | None" = None

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        model: DvfModel | None = None,
        *,
        fixtures: "FixtureSet | None" = None,
        retiming: RetimingName | None = None,
        record: "LiveRecord | None" = None,
    ) -> "SessionFiles":
        """The recordings of a scenario, part by part."""
        return cls(
            preop=PreopFiles(scenario.preop, model),
            sweep=readers.Sweep(scenario.ultrasound, scenario.ultrasound.stream("tracker", "probe")),
            fan=scenario.fan,
            ecg=scenario.ecg,
            tool=scenario.tool,
            respiration=scenario.respiration,
            probe=scenario.probe,
            latency=scenario.latency,
            tip=scenario.tip,
            start=readers.StartFiles(
                scenario.start,
                scenario.landmarks_mr,
                scenario.landmarks_tracker,
                scenario.touched,
                scenario.touched_phase,
            ),
            fixtures=fixtures,
            retiming=retiming,
            truth=scenario.truth,
            name=scenario.name,
            preset=scenario.preset,
            seed=scenario.seed,
            tracked_against=scenario.tracked_against,
            record=record,
        )

    @property
    def model(self) -> DvfModel | None:
        """Model of the patient, if a file holds it."""
        return None if self.preop is None else self.preop.model

    @property
    def heart(self) -> Preop:
        """The pre-operative heart.

        Raises:
            InvalidInputError: there is none.
        """
        if self.preop is None:
            raise _missing("preop")
        return self.preop.preop

    @property
    def required_live(self) -> LiveConfig:
        """Who sends what.

        Raises:
            InvalidInputError: the session does not say.
        """
        if self.live is None:
            raise InvalidInputError("the session does not say who sends what", key="live")
        return self.live

    @property
    def calibrations(self) -> CalibrationSources:
        """Calibrations, or what they are made from.

        Raises:
            InvalidInputError: the probe's or the latency is missing.
        """
        if self.probe is None or self.latency is None:
            raise _missing("calibration.probe" if self.probe is None else "calibration.latency")
        return CalibrationSources(self.probe, self.latency, self.tip)

    def with_calibrations(self, probe: ImageMap, lag_s: float, tip: Points | None) -> "SessionFiles":
        """Replace recordings of calibrations by the calibrations made from them."""
        return replace(self, probe=probe, latency=lag_s, tip=tip)

    def with_model(self, model: DvfModel) -> "SessionFiles":
        """Add the patient's model."""
        read = PreopFiles(self.heart, model) if self.preop is None else replace(self.preop, model=model)
        return replace(self, preop=read)

    @property
    def scenario(self) -> Scenario:
        """Every recording under the names of a scenario.

        Raises:
            InvalidInputError: heart, sweep, ECG or a calibration is missing.
        """
        heart, sweep, ecg, probe, latency = self.preop, self.sweep, self.ecg, self.probe, self.latency
        if heart is None or sweep is None or ecg is None or probe is None or latency is None:
            absent = {"preop": heart, "ultrasound": sweep, "ecg": ecg, "calibration.probe": probe}
            raise _missing(next((k for k, value in absent.items() if value is None), "calibration.latency"))
        named = replace(sweep.probe, target="tracker", source="probe")
        start, tool = self.start, self.tool
        return Scenario(
            name=self.name or heart.preop.patient_id,
            preset=self.preset,
            preop=heart.preop,
            ecg=ecg,
            ultrasound=replace(sweep.recorded, poses={named.name: named}),
            fan=self.fan,
            probe=probe,
            latency=latency,
            tool=None if tool is None else replace(tool, target="tracker", source="tool"),
            tracked_against=self.tracked_against or sweep.probe.target,
            tip=self.tip,
            start=start.start,
            landmarks_mr=start.landmarks_mr,
            landmarks_tracker=start.landmarks_tracker,
            touched=start.touched,
            touched_phase=start.touched_phase,
            seed=self.seed,
            truth=self.truth,
            respiration=self.respiration,
        )

    @property
    def recorded_calibrations(self) -> bool:
        """Whether a calibration is to be made from its recording."""
        raw = (NWireRecording, TargetRecording, LatencyRecording, PoseStream)
        return any(isinstance(part, raw) for part in (self.probe, self.latency, self.tip))


@dataclass(frozen=True, slots=True, eq=False)
class Opened:
    """A configuration while its parts are read.

    Attributes:
        folder: where names of files begin.
        names: of probe and reference in the recordings.
        tool: what the recording of its poses calls the tool, if they are not read.
        read: the fields of `SessionFiles` that were read before.
    """

    config: SessionConfig
    folder: Path
    names: ProbeNames
    tool: str = "tool"
    read: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a session.

    Attributes:
        key: of the configuration.
        label: what people call it.
        read: the fields of `SessionFiles` that its files give.
        describe: what the files hold, in a line; None if nothing is there.
        is_there: whether it was read.
        needed_for: "register" if a registration and a replay need it, "replay" if only a replay does.
        missing: what needs it, and how to come by it.
        live: whether a live session reads it; the rest is sent.
    """

    key: str
    label: str
    read: Callable[[Opened], Mapping[str, Any]]
    describe: Callable[[SessionFiles], str | None]
    is_there: Callable[[SessionFiles], bool]
    needed_for: Use | None = None
    missing: str = ""
    live: bool = False

    @property
    def missing_error(self) -> InvalidInputError:
        return InvalidInputError(self.missing, key=self.key)


def missing_parts(files: SessionFiles, wrong: ProblemList | None = None) -> tuple[Problem, ...]:
    """Parts that a registration or a replay needs and that are not there.

    Args:
        wrong: known problems; a part that one of them concerns is not named again.
    """
    return tuple(
        Problem(part.key, part.missing_error, part.needed_for)
        for part in PARTS
        if part.needed_for and not part.is_there(files) and not (wrong is not None and wrong.within(part.key))
    )


def _read_heart(at: Opened) -> Mapping[str, Any]:
    heart = at.config.preop
    return {} if heart is None else {"preop": read_preop(heart, at.folder, at.config.patient_id)}


def _read_ultrasound(at: Opened) -> Mapping[str, Any]:
    us = at.config.ultrasound
    if us is None:
        return {}
    with concerning("ultrasound.fan"):
        read: dict[str, Any] = {"fan": None if us.fan is None else us.fan.fan()}
    if us.file is not None:
        with concerning("ultrasound.file", at.folder / us.file):
            read["sweep"] = readers.read_sweep(at.folder / us.file, at.names)
    with concerning("ultrasound.volumes"):
        files = tuple(replace(file, path=at.folder / file.path) for file in gated_volume_files(us.volumes))
        at.read["volumes"] = files  # readable or not: what else is needed depends on them
        files = at.read["volumes"] = sequence_volumes(files)
        read_gated_volumes(files, [file.phase or 0.0 for file in files])
    return read


def _read_ecg(at: Opened) -> Mapping[str, Any]:
    us = at.config.ultrasound
    sweep = at.folder / us.file if us is not None and us.file is not None else None
    if at.config.ecg is None and (at.read.get("sweep") is None or sweep is None):
        return {}
    return {"ecg": readers.read_session_ecg(at.config.ecg, at.folder, sweep)}


def _read_respiration(at: Opened) -> Mapping[str, Any]:
    config = at.config.respiration
    if config is None:
        return {}
    parts = split_respiration(config.file)
    path = at.folder / parts.name
    with concerning("respiration.file", path):
        return {"respiration": read_respiration(f"{parts.prefix}{path}{parts.field}", config.rate_hz)}


def _read_probe(at: Opened) -> Mapping[str, Any]:
    probe = at.config.calibration.probe
    sweep = at.read.get("sweep")
    turned_from = None if sweep is None else sweep.recorded.turned_from
    return (
        {} if probe is None else {"probe": readers.read_probe_source(probe, at.folder, at.names, turned_from)}
    )


def _read_latency(at: Opened) -> Mapping[str, Any]:
    latency = at.config.calibration.latency
    return {} if latency is None else {"latency": readers.read_latency_source(latency, at.folder, at.names)}


def _read_tip(at: Opened) -> Mapping[str, Any]:
    tip, tool = at.config.calibration.tip, at.read.get("tool")
    name = at.tool if tool is None else tool.source
    return {} if tip is None else {"tip": readers.read_tip_source(tip, at.folder, name)}


def _read_device(at: Opened) -> Mapping[str, Any]:
    device = at.config.calibration.device
    return {} if device is None else {"device": readers.read_device_place(at.folder / device)}


def _of_volumes(files: SessionFiles) -> bool:
    return bool(files.volumes) and files.sweep is None


PARTS = (
    Part(
        "preop",
        "heart",
        _read_heart,
        lambda files: contents.heart_contents(files.preop),
        lambda files: files.preop is not None,
        "register",
        "a registration needs the heart: its model (dvf-ig model build … -o heart.npz), labels, or surfaces",
        live=True,
    ),
    Part(
        "ultrasound",
        "ultrasound",
        _read_ultrasound,
        lambda files: contents.ultrasound_contents(files.sweep, files.volumes),
        lambda files: files.sweep is not None or bool(files.volumes),
        "register",
        "a registration needs ultrasound: a tracked sweep (PLUS sequence), or gated 3-D images",
    ),
    Part(
        "ecg",
        "ECG",
        _read_ecg,
        lambda files: contents.ecg_contents(files.ecg),
        lambda files: files.ecg is not None or (_of_volumes(files) and not _timed(files)),
        "register",
        "a registration needs the ECG, which tells when in the cycle each image was taken",
    ),
    Part(
        "tool",
        "tool",
        lambda at: {"tool": readers.read_tool(at.config.tool, at.folder, at.read.get("sweep"))},
        lambda files: contents.tool_contents(files.tool, files.sweep),
        lambda files: files.tool is not None,
        "replay",
        "a force needs the tool's poses: a tracked sequence of the tool on the ECG's clock",
    ),
    Part(
        "respiration",
        "breathing",
        _read_respiration,
        lambda files: contents.respiration_contents(files.respiration),
        lambda files: files.respiration is not None,
    ),
    Part(
        "calibration.probe",
        "probe calibration",
        _read_probe,
        lambda files: contents.probe_contents(files.probe, files.sweep),
        lambda files: files.probe is not None or _of_volumes(files),
        "register",
        "a registration needs the probe's calibration: dvf-ig calibrate probe SWEEP --device-set XML "
        "-o probe.json",
        live=True,
    ),
    Part(
        "calibration.latency",
        "latency",
        _read_latency,
        lambda files: contents.latency_contents(files.latency),
        lambda files: files.latency is not None or _of_volumes(files),
        "register",
        "a registration needs the latency of the images: dvf-ig calibrate latency TRACKER VIDEO "
        "-o latency.json, or seconds where it is known",
        live=True,
    ),
    Part(
        "calibration.tip",
        "tool tip",
        _read_tip,
        lambda files: contents.tip_contents(files.tip),
        lambda files: files.tip is not None,
        "replay",
        "a force needs a tool tip: dvf-ig calibrate pivot POSES -o tip.json",
        live=True,
    ),
    Part(
        "calibration.device",
        "haptic device",
        _read_device,
        lambda files: contents.device_contents(files.device),
        lambda files: files.device is not None,
        missing="a force needs the place of its haptic device: dvf-ig calibrate device POINTS --device NAME "
        "-o device.json",
        live=True,
    ),
    Part(
        "start",
        "start",
        lambda at: {"start": readers.read_start(at.config.start, at.folder)},
        lambda files: contents.start_contents(files.start),
        lambda files: any(
            one is not None for one in (files.start.start, files.start.landmarks_mr, files.start.touched)
        ),
        "register",
        "a registration needs a start: a coarse mr_from_tracker (.tfm), or three landmarks or more marked on "
        "the model and touched on the patient, or points touched all over the heart's surface",
        live=True,
    ),
)


def _timed(files: SessionFiles) -> bool:
    """Whether a gated volume is placed by its time, so that the ECG is needed."""
    return any(file.t_s is not None for file in files.volumes)


def _missing(key: str) -> InvalidInputError:
    return next(part for part in PARTS if part.key == key).missing_error


def descriptions(files: SessionFiles) -> dict[str, str | None]:
    """Contents of each part in a line, by its key; None if it is not there."""
    return {part.key: part.describe(files) for part in PARTS}
