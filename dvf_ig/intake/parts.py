"""The parts of a session, each read from the files that the configuration names for it."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.recordings.phantom import NWireRecording, TargetRecording
from dvf_ig.core.recordings.scenario import LatencyRecording
from dvf_ig.core.recordings.sequence import Fan, TrackedSequence
from dvf_ig.core.recordings.signal import Signal
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.points import Landmarks, Points
from dvf_ig.core.space.rigid import Rigid
from dvf_ig.core.timing.trigger import TriggerTimes
from dvf_ig.intake.ecg_name import split_ecg
from dvf_ig.intake.preop import PreopFiles
from dvf_ig.intake.schema import EcgConfig, StartConfig, ToolConfig
from dvf_ig.io.ecg.recording import read_ecg
from dvf_ig.io.ecg.trigger import read_beat_source
from dvf_ig.io.landmarks import read_landmarks
from dvf_ig.io.plus.feature_points import tracked_probe
from dvf_ig.io.plus.names import ProbeNames, frame_from_plus
from dvf_ig.io.plus.poses import read_poses
from dvf_ig.io.plus.sequence_read import read_sequence
from dvf_ig.io.points_file import read_points
from dvf_ig.io.reading import reading
from dvf_ig.io.transform import read_transform

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Tracked ultrasound as recorded, and which of its poses are the probe's."""

    recorded: TrackedSequence
    probe: PoseStream

    @property
    def other_tools(self) -> tuple[str, ...]:
        """What else was tracked against the same, by its recorded name; a tool's tip is no tool."""
        probe, streams = self.probe, self.recorded.poses.values()
        found = {s.source for s in streams} - {probe.source, probe.target, "reference", "tracker"}
        return tuple(sorted(found - {f"{name}_tip" for name in found}))


@dataclass(frozen=True, slots=True, eq=False)
class StartFiles:
    """What a registration starts from, as fields of a scenario."""

    start: Rigid | None = None
    landmarks_mr: Landmarks | None = None
    landmarks_tracker: Landmarks | None = None
    touched: Points | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SessionParts:
    """What could be read of a session; None where a part is not named, or cannot be read.

    Poses have the names that the recording gives them; calibrations those of a scenario.
    """

    preop: PreopFiles | None = None
    sweep: Sweep | None = None
    fan: Fan | None = None
    ecg: Signal | TriggerTimes | None = None
    tool: PoseStream | None = None
    probe: ImageMap | NWireRecording | TargetRecording | None = None
    latency: float | LatencyRecording | None = None
    tip: Points | PoseStream | None = None
    start: StartFiles = StartFiles()

    @property
    def recorded_calibrations(self) -> bool:
        """Whether a calibration is to be made from its recording."""
        raw = (NWireRecording, TargetRecording, LatencyRecording, PoseStream)
        return any(isinstance(part, raw) for part in (self.probe, self.latency, self.tip))


def read_sweep(path: Path, names: ProbeNames) -> Sweep:
    """Raises UnreadableFileError: not a sequence, or the probe is not in it."""
    with reading(path, "tracked ultrasound"):
        recorded = read_sequence(path)
        return Sweep(recorded, tracked_probe(recorded, names))


def read_tool(config: ToolConfig | None, folder: Path, sweep: Sweep | None) -> PoseStream | None:
    """The tool's poses against what the probe's are relative to; None where none is named or recorded.

    Without a name the only other tool in the ultrasound sequence is taken.
    """
    held = None if sweep is None else sweep.probe.target
    if config is None:
        others = () if sweep is None else sweep.other_tools
        if len(others) > 1:
            log.warning(
                "the ultrasound tracks %s beside the probe; say which is the tool (tool.file, tool.name)",
                " and ".join(others),
            )
        if sweep is None or held is None or len(others) != 1:
            return None
        return sweep.recorded.stream(held, others[0])
    source = None if config.name is None else frame_from_plus(config.name)
    try:
        poses = read_poses(folder / config.file, held, source)
        if sweep is not None and poses.source == sweep.probe.source:
            raise UnreadableFileError(
                f"{folder / config.file} tracks the probe; give a sequence that tracks the tool, or name the "
                "tool (tool.name)"
            )
        return poses
    except UnreadableFileError as exc:
        if isinstance(exc.__cause__, InvalidInputError) and "the sequence" in str(exc):
            raise UnreadableFileError(
                f"{exc}; say what the recording calls the tool (tool.name) and what the probe's and the "
                "tool's poses are relative to (ultrasound.reference_name)"
            ) from exc
        raise


def read_session_ecg(config: EcgConfig | None, folder: Path, sweep: Path) -> Signal | TriggerTimes:
    """From its own file, else from the field data of the ultrasound.

    Raises:
        UnreadableFileError: it cannot be read; or none is named, and the ultrasound has none.
    """
    if config is None:
        try:
            return read_ecg(f"plus:{sweep}")
        except InvalidInputError as exc:
            raise UnreadableFileError(
                f"no file of an ECG is named, and the ultrasound gives none: {exc}"
            ) from exc
    spec = split_ecg(config.file)
    named = f"{spec.prefix}{folder / spec.name}{spec.field}"
    found = read_beat_source(named, rate_hz=config.rate_hz, delay_s=config.delay_s)
    if config.start_s is None:
        return found
    if isinstance(found, TriggerTimes):
        raise UnreadableFileError(
            f"{folder / spec.name} holds times of pulses on the tracker's clock; leave out ecg.start_s"
        )
    return replace(found, start_s=config.start_s)


def read_start(config: StartConfig, folder: Path) -> StartFiles:
    """Transform, landmarks and touched points, whichever are named."""
    transform, mr, tracker, touched = (
        None if name is None else folder / name
        for name in (config.transform, config.landmarks_mr, config.landmarks_tracker, config.touched)
    )
    return StartFiles(
        start=None if transform is None else read_transform(transform, "mr", "tracker"),
        landmarks_mr=None if mr is None else read_landmarks(mr, "mr"),
        landmarks_tracker=None if tracker is None else read_landmarks(tracker, "tracker"),
        touched=None if touched is None else read_points(touched, "tracker"),
    )
