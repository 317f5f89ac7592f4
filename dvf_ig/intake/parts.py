"""The parts of a session: one table of what each is, what reads it, what it is for, and what is said of it.

A new part is a row and a field of `SessionFiles` here, its section and keys in `intake.schema`, and a field
of `Scenario`. `PARTS` are read in their order: a part may use those above it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dvf_ig.cardiac import stream_recording
from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.model import DvfModel
from dvf_ig.core.recordings.phantom import NWireRecording, TargetRecording
from dvf_ig.core.recordings.scenario import LatencyRecording, Preop, Scenario, ScenarioTruth
from dvf_ig.core.recordings.sequence import Fan
from dvf_ig.core.recordings.signal import Signal
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.points import Points
from dvf_ig.core.space.volume import VolumeSeries
from dvf_ig.core.timing.cycle import CycleTiming
from dvf_ig.core.timing.trigger import TriggerTimes
from dvf_ig.io.image.gated_volume import GatedVolumeFile, gated_volume_files, read_gated_volumes
from dvf_ig.io.plus.names import ProbeNames
from dvf_ig.registration import start_from_landmarks
from dvf_ig.registration.lc2.slices import fan_mask_from_images

from .fixtures import RetimingName
from .live import LiveConfig
from .preop import PreopFiles, preop_label_values, read_preop
from .problems import Problem, ProblemList, Use, concerning
from .readers import (
    StartFiles,
    Sweep,
    read_latency_source,
    read_probe_source,
    read_session_ecg,
    read_start,
    read_sweep,
    read_tip_source,
    read_tool,
)
from .schema import SessionConfig

if TYPE_CHECKING:
    from dvf_ig.guidance import FixtureSet

    from .live_record import LiveRecord

DARK_BORDER = 0.02
"""A sector leaves at least this share of the image dark."""


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
        fixtures, retiming: None if the configuration does not say.
        live: who sends what in a live session.
        folder: where names of files begin.
        named: every file by the key that names it.
        tracked_against: of poses that are already renamed, what the recording called the tracker.
        record: of a live session, what repeats it.
    """

    preop: PreopFiles | None = None
    sweep: Sweep | None = None
    volumes: tuple[GatedVolumeFile, ...] = ()
    fan: Fan | None = None
    ecg: Signal | TriggerTimes | None = None
    tool: PoseStream | None = None
    probe: ImageMap | NWireRecording | TargetRecording | None = None
    latency: float | LatencyRecording | None = None
    tip: Points | PoseStream | None = None
    start: StartFiles = field(default_factory=StartFiles)
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
            sweep=Sweep(scenario.ultrasound, scenario.ultrasound.stream("tracker", "probe")),
            fan=scenario.fan,
            ecg=scenario.ecg,
            tool=scenario.tool,
            probe=scenario.probe,
            latency=scenario.latency,
            tip=scenario.tip,
            start=StartFiles(
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
            raise PARTS[0].missing_error
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
            raise next(
                p for p in PARTS if p.key.startswith("calibration") and not p.is_there(self)
            ).missing_error
        return CalibrationSources(self.probe, self.latency, self.tip)

    def with_calibrations(self, probe: ImageMap, lag_s: float, tip: Points | None) -> "SessionFiles":
        """Replace recordings of calibrations by the calibrations made from them."""
        return replace(self, probe=probe, latency=lag_s, tip=tip)

    def with_model(self, model: DvfModel) -> "SessionFiles":
        """Add the patient's model."""
        named = None if self.preop is None else self.preop.named_patient
        return replace(self, preop=PreopFiles(self.heart, model, named))

    @property
    def scenario(self) -> Scenario:
        """Every recording under the names of a scenario.

        Raises:
            InvalidInputError: heart, sweep, ECG or a calibration is missing.
        """
        heart, sweep, ecg, probe, latency = self.preop, self.sweep, self.ecg, self.probe, self.latency
        if heart is None or sweep is None or ecg is None or probe is None or latency is None:
            raise next(part for part in PARTS if part.needed_for and not part.is_there(self)).missing_error
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
            read["sweep"] = read_sweep(at.folder / us.file, at.names)
    with concerning("ultrasound.volumes"):
        files = tuple(replace(file, path=at.folder / file.path) for file in gated_volume_files(us.volumes))
        at.read["volumes"] = files  # readable or not: what else is needed depends on them
        read_gated_volumes([file.path for file in files], [file.phase or 0.0 for file in files])
    return read


def _read_ecg(at: Opened) -> Mapping[str, Any]:
    us = at.config.ultrasound
    sweep = at.folder / us.file if us is not None and us.file is not None else None
    if at.config.ecg is None and (at.read.get("sweep") is None or sweep is None):
        return {}
    return {"ecg": read_session_ecg(at.config.ecg, at.folder, sweep)}


def _read_tool(at: Opened) -> Mapping[str, Any]:
    return {"tool": read_tool(at.config.tool, at.folder, at.read.get("sweep"))}


def _read_probe(at: Opened) -> Mapping[str, Any]:
    probe = at.config.calibration.probe
    return {} if probe is None else {"probe": read_probe_source(probe, at.folder, at.names)}


def _read_latency(at: Opened) -> Mapping[str, Any]:
    latency = at.config.calibration.latency
    return {} if latency is None else {"latency": read_latency_source(latency, at.folder, at.names)}


def _read_tip(at: Opened) -> Mapping[str, Any]:
    tip, tool = at.config.calibration.tip, at.read.get("tool")
    name = at.tool if tool is None else tool.source
    return {} if tip is None else {"tip": read_tip_source(tip, at.folder, name)}


def _read_start(at: Opened) -> Mapping[str, Any]:
    return {"start": read_start(at.config.start, at.folder)}


def _heart(files: SessionFiles) -> str | None:
    if files.preop is None:
        return None
    preop, model, words = files.preop.preop, files.preop.model, []
    if model is not None:
        words.append(f"model of patient '{model.patient_id}', {model.surface_name}, {_phases(model.timing)}")
    if preop.mr is not None:
        words.append(f"grey levels of {_phases(preop.mr.timing)}, {_size(preop.mr)}")
    listed = _listed(preop_label_values(preop))
    if preop.labels is not None:
        words.append(f"labels {listed} in each of {_phases(preop.labels.timing)}")
    elif preop.ed_labels is not None:
        words.append(f"labels {listed} of end-diastole alone (phase {preop.ed_phase})")
    if preop.surfaces:
        names = ", ".join(series.name for series in preop.surfaces)
        words.append(f"surfaces {names}, {_phases(preop.surfaces[0].timing)}")
    return "; ".join(words)


def _listed(values: tuple[int, ...]) -> str:
    """ "1 to 4" if none is left out, else one by one."""
    if len(values) > 2 and values[-1] - values[0] == len(values) - 1:
        return f"{values[0]} to {values[-1]}"
    return ", ".join(map(str, values)) or "none"


def _phases(timing: CycleTiming) -> str:
    assumed = " (times assumed: no timing.json)" if timing.timing_assumed and timing.rr_assumed else ""
    return f"{len(timing)} phases{assumed}"


def _size(series: VolumeSeries) -> str:
    shape = " x ".join(map(str, series.grid.shape))
    return f"{shape} voxels of {' x '.join(f'{side:.2g}' for side in series.grid.spacing_mm)} mm"


def _ultrasound(files: SessionFiles) -> str | None:
    sweep = files.sweep
    if sweep is None:
        names = ", ".join(file.path.name for file in files.volumes)
        return f"gated volumes {names}" if names else None
    recorded, probe = sweep.recorded, sweep.probe
    if recorded.images is None:
        return f"no images; {_poses(probe)}"
    rows, columns = recorded.images.shape[1:]
    share = float(fan_mask_from_images(recorded.images).mean())
    sector = f"sector on {share:.0%} of it" if share <= 1 - DARK_BORDER else "no dark border around a sector"
    frames = {frame for s in recorded.poses.values() for frame in (s.target, s.source)}
    against = f"relative to {probe.target}"
    if probe.target == "tracker":
        against = "the reference marker not used" if "reference" in frames else "no reference marker"
    return f"{len(recorded)} images of {columns} x {rows} px, {sector}; {_poses(probe)}, {against}"


def _poses(stream: PoseStream) -> str:
    return f"{stream.name} tracked for {stream.valid.mean():.0%}, {_span(stream.t_s)}"


def _span(t_s: FloatArray) -> str:
    return f"{t_s[0]:.1f} to {t_s[-1]:.1f} s".replace("-0.0 to", "0.0 to")


def _ecg(files: SessionFiles) -> str | None:
    ecg = files.ecg
    if ecg is None:
        return None
    source = "trigger" if isinstance(ecg, TriggerTimes) else f"{', '.join(ecg.leads)} at {ecg.rate_hz:g} Hz"
    return f"{source}, {_span(ecg.t_s)}; {_beats(ecg)}"


def _beats(ecg: Signal | TriggerTimes) -> str:
    try:
        peaks, _ = stream_recording(ecg)
    except InvalidInputError:
        return "no R peaks found"
    if len(peaks) < 2:
        return f"{len(peaks)} R peaks"
    rate_bpm = 60.0 / float(np.median(np.diff([peak.t_s for peak in peaks])))
    return f"{len(peaks)} R peaks, {rate_bpm:.0f} beats/min"


def _tool(files: SessionFiles) -> str | None:
    if files.tool is not None:
        return _poses(files.tool)
    others = () if files.sweep is None else files.sweep.other_tools
    return f"one of {', '.join(others)}: say which (tool.name)" if len(others) > 1 else None


def _probe(files: SessionFiles) -> str | None:
    probe, sweep = files.probe, files.sweep
    if probe is None:
        return None
    if not isinstance(probe, ImageMap):
        kind = "N-wire" if isinstance(probe, NWireRecording) else probe.phantom
        return f"recording of the {kind} phantom, {len(probe.points_px)} images"
    across, down = probe.scale_mm_per_px.tolist()
    text = f"pixels of {across:.4g} x {down:.4g} mm"
    if sweep is None or sweep.recorded.images is None:
        return text
    rows, columns = sweep.recorded.images.shape[1:]
    return f"{text}: images of {columns * across:.0f} x {rows * down:.0f} mm"


def _latency(files: SessionFiles) -> str | None:
    if files.latency is None:
        return None
    if isinstance(files.latency, float):
        return f"{files.latency:+.4f} s (time of tracker = time of video + latency)"
    return f"recording of a water tank, {len(files.latency.wall_row_px.t_s)} images"


def _tip(files: SessionFiles) -> str | None:
    tip = files.tip
    if tip is None:
        return None
    if isinstance(tip, PoseStream):
        return f"pivot recording, {_poses(tip)}"
    place = ", ".join(f"{side:.1f}" for side in tip.xyz_mm[0])
    return f"at ({place}) mm in the tool's own frame"


def _start(files: SessionFiles) -> str | None:
    start, words = files.start, []
    if start.start is not None:
        words.append("start pose")
    mr, tracker = start.landmarks_mr, start.landmarks_tracker
    if mr is not None and tracker is not None:
        words.append(f"{len(mr.paired_with(tracker)[0])} landmarks named in both files{_residual(start)}")
    if start.touched is not None:
        words.append(f"{len(start.touched)} points touched on the surface")
    return "; ".join(words) or None


def _residual(start: StartFiles) -> str:
    if start.landmarks_mr is None or start.landmarks_tracker is None:
        return ""
    try:
        residuals = start_from_landmarks(start.landmarks_mr, start.landmarks_tracker).residuals_mm
    except InvalidInputError:
        return ""
    return f", residual {float(np.sqrt((residuals**2).mean())):.1f} mm RMS"


def _of_volumes(files: SessionFiles) -> bool:
    return bool(files.volumes) and files.sweep is None


PARTS = (
    Part(
        "preop",
        "heart",
        _read_heart,
        _heart,
        lambda files: files.preop is not None,
        "register",
        "a registration needs the heart: its model (dvf-ig model build … -o heart.npz), labels, or surfaces",
        live=True,
    ),
    Part(
        "ultrasound",
        "ultrasound",
        _read_ultrasound,
        _ultrasound,
        lambda files: files.sweep is not None or bool(files.volumes),
        "register",
        "a registration needs ultrasound: a tracked sweep (PLUS sequence), or gated 3-D images",
    ),
    Part(
        "ecg",
        "ECG",
        _read_ecg,
        _ecg,
        lambda files: files.ecg is not None or (_of_volumes(files) and not _timed(files)),
        "register",
        "a registration needs the ECG, which tells when in the cycle each image was taken",
    ),
    Part(
        "tool",
        "tool",
        _read_tool,
        _tool,
        lambda files: files.tool is not None,
        "replay",
        "a force needs the tool's poses: a tracked sequence of the tool on the ECG's clock",
    ),
    Part(
        "calibration.probe",
        "probe calibration",
        _read_probe,
        _probe,
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
        _latency,
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
        _tip,
        lambda files: files.tip is not None,
        "replay",
        "a force needs a tool tip: dvf-ig calibrate pivot POSES -o tip.json",
        live=True,
    ),
    Part(
        "start",
        "start",
        _read_start,
        _start,
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


def descriptions(files: SessionFiles) -> dict[str, str | None]:
    """Contents of each part in a line, by its key; None if it is not there."""
    return {part.key: part.describe(files) for part in PARTS}
