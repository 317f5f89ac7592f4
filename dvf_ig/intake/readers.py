"""Read the parts of a session from the files that its configuration names for them."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

from dvf_ig.core import ImageMap, LatencyRecording, PoseStream, Rigid, Signal, TrackedSequence, TriggerTimes
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.recordings.phantom import NWireRecording, TargetRecording
from dvf_ig.core.space.points import Landmarks, Points
from dvf_ig.io import read_ecg, read_landmarks, read_latency_recording, read_nwire_recording, read_sequence
from dvf_ig.io.calibration_files import read_lag, read_landmark_map, read_probe, read_tip
from dvf_ig.io.ecg.trigger import read_beat_source, split_ecg
from dvf_ig.io.plus.feature_points import read_target_recording, tracked_probe
from dvf_ig.io.plus.names import ProbeNames, frame_from_plus, same_sensor
from dvf_ig.io.plus.poses import SEQUENCE_SUFFIXES, read_poses, recorded_poses
from dvf_ig.io.points_file import read_points
from dvf_ig.io.reading import reading
from dvf_ig.io.transform import read_transform

from .problems import concerning
from .schema import EcgConfig, LatencyConfig, NWireConfig, PivotConfig, StartConfig, TargetConfig, ToolConfig

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Tracked ultrasound as recorded, and which of its poses are the probe's."""

    recorded: TrackedSequence
    probe: PoseStream

    @property
    def other_tools(self) -> tuple[str, ...]:
        """Other tools tracked against the reference, by their recorded names; a tool's tip is no tool."""
        probe, streams = self.probe, self.recorded.poses.values()
        sources = {s.source for s in streams} - {probe.source, probe.target, "reference", "tracker"}
        return tuple(sorted(sources - {f"{name}_tip" for name in sources}))


@dataclass(frozen=True, slots=True, eq=False)
class StartFiles:
    """Start of a registration, as fields of a scenario."""

    start: Rigid | None = None
    landmarks_mr: Landmarks | None = None
    landmarks_tracker: Landmarks | None = None
    touched: Points | None = None
    touched_phase: float | None = None


def read_sweep(path: Path, names: ProbeNames) -> Sweep:
    """Raises UnreadableFileError: not a sequence, or the probe is not in it."""
    with reading(path, "tracked ultrasound"):
        recorded = read_sequence(path)
        return Sweep(recorded, tracked_probe(recorded, names))


def read_tool(config: ToolConfig | None, folder: Path, sweep: Sweep | None) -> PoseStream | None:
    """The tool's poses against what the probe's are relative to; None if none is named or recorded.

    Without a name the only other tool in the ultrasound sequence is taken.
    """
    reference = None if sweep is None else sweep.probe.target
    if config is None or config.file is None:
        others = () if sweep is None else sweep.other_tools
        if len(others) > 1:
            log.warning(
                "the ultrasound tracks %s beside the probe; say which is the tool (tool.file, tool.name)",
                " and ".join(others),
            )
        if sweep is None or reference is None or len(others) != 1:
            return None
        return sweep.recorded.stream(reference, others[0])
    path = folder / config.file
    with concerning("tool.file", path):
        try:
            poses = recorded_poses(
                path, reference, None if config.name is None else frame_from_plus(config.name)
            )
        except UnreadableFileError as exc:
            if isinstance(exc.__cause__, InvalidInputError):  # the poses that are asked for are not in it
                exc.settings = exc.settings or ("tool.name", "ultrasound.reference_name")
            raise
        if sweep is not None and poses.source == sweep.probe.source:
            raise UnreadableFileError(
                f"{path} tracks the probe; give a sequence that tracks the tool, or name the tool",
                settings=("tool.name",),
            )
        return poses


def read_session_ecg(config: EcgConfig | None, folder: Path, sweep: Path | None) -> Signal | TriggerTimes:
    """From its own file, else from the field data of the ultrasound.

    Raises:
        UnreadableFileError: it cannot be read; or none is named, and the ultrasound has none.
    """
    if config is None:
        try:
            return read_ecg(f"plus:{sweep}")
        except InvalidInputError as exc:
            raise UnreadableFileError(
                f"no file of an ECG is named, and the ultrasound gives none: {exc.message}",
                settings=("ecg.file",),
            ) from exc
    return read_channel(config, folder, "ecg.file")


def read_channel(config: EcgConfig, folder: Path, key: str) -> Signal | TriggerTimes:
    """A signal or pulses from a file of their own.

    Args:
        key: that names the file, for messages.
    """
    spec = split_ecg(config.file)
    with concerning(key, folder / spec.name):
        named = f"{spec.prefix}{folder / spec.name}{spec.field}"
        ecg = read_beat_source(named, rate_hz=config.rate_hz, delay_s=config.delay_s, lead=config.lead)
        if config.start_s is None:
            return ecg
        if isinstance(ecg, TriggerTimes):
            raise UnreadableFileError(
                f"{folder / spec.name} holds times of pulses on the tracker's clock; leave out ecg.start_s"
            )
        return replace(ecg, start_s=config.start_s)


def read_start(config: StartConfig, folder: Path) -> StartFiles:
    """Transform, landmarks and touched points, whichever are named."""
    start, marked, at, touched = None, None, None, None
    if config.transform is not None:
        with concerning("start.transform", path := folder / config.transform):
            start = read_transform(path, "mr", "tracker")
    if config.landmarks_mr is not None:
        with concerning("start.landmarks_mr", path := folder / config.landmarks_mr):
            marked = read_landmarks(path, "mr")
    if config.landmarks_tracker is not None:
        with concerning("start.landmarks_tracker", path := folder / config.landmarks_tracker):
            at = read_landmarks(path, "tracker")
    if config.touched is not None:
        with concerning("start.touched", path := folder / config.touched):
            touched = read_points(path, "tracker")
    return StartFiles(start, marked, at, touched, config.touched_phase)


def read_probe_source(
    source: str | NWireConfig | TargetConfig, folder: Path, names: ProbeNames, turned_from: str | None = None
) -> ImageMap | NWireRecording | TargetRecording:
    """probe_from_image, or the sweep of a phantom.

    Args:
        names: of probe and reference in the recordings; the result's frame is "probe" whatever its name.
        turned_from: orientation in which the sweep's images are stored, if they were turned.
    """
    if isinstance(source, str):
        calibration = read_probe(folder / source, names.probe, turned_from=turned_from)
        rigid = calibration.rigid
        placed = Rigid("probe", rigid.source, rigid.rotation, rigid.translation_mm)
        return ImageMap(placed, calibration.scale_mm_per_px, calibration.shear_deg)
    file = folder / source.file
    if isinstance(source, NWireConfig):
        return read_nwire_recording(
            file, folder / source.device_set, folder / source.points, "CalibrationData", names
        )
    poses, points_px = read_target_recording(file, folder / source.points, names)
    return TargetRecording(source.phantom, replace(poses, source="probe"), points_px)


def read_latency_source(
    source: str | float | LatencyConfig, folder: Path, names: ProbeNames
) -> float | LatencyRecording:
    """lag_s, or a water-tank sweep.

    Args:
        names: of probe and reference in the recording.
    """
    if isinstance(source, str):
        return read_lag(folder / source)
    if isinstance(source, LatencyConfig):
        return read_latency_recording(
            folder / source.tracker, folder / source.video, folder / source.lines, names
        )
    return float(source)


def read_device_place(path: Path) -> Rigid:
    """Read tracker_from_device that `dvf-ig calibrate device` wrote.

    Raises:
        UnreadableFileError: a transform between other frames.
    """
    place = read_landmark_map(path)
    if (place.target, place.source) != ("tracker", "device"):
        raise UnreadableFileError(
            f"{path} is {place.name}; needed tracker_from_device: dvf-ig calibrate device POINTS -o FILE"
        )
    return place


def read_tip_source(source: str | PivotConfig, folder: Path, tool: str) -> Points | PoseStream:
    """The tip, or the poses while pivoting; the frame is "tool" whatever the tool's name.

    Args:
        tool: the tool's name in the recording of its poses.
    Raises:
        UnreadableFileError: a tip or poses of another tool.
    """
    if isinstance(source, PivotConfig):
        return _pivoting(folder / source.pivot, tool)
    path = folder / source
    tip = read_tip(path, tool if path.suffix.lower() == ".xml" else None)
    if "tool" not in (tool, tip.frame) and not same_sensor(tip.frame, tool):
        raise UnreadableFileError(
            f"{path} is the tip of '{tip.frame}', but the recorded tool is '{tool}'; calibrate this tool, or "
            "name the recorded one",
            settings=("tool.name",),
        )
    return Points("tool", tip.xyz_mm)


def _pivoting(path: Path, tool: str) -> PoseStream:
    """Poses of this tool, whatever else was tracked while it pivoted; one that is just "tool" is any tool."""
    name = None
    if tool != "tool" and path.suffix.lower() in SEQUENCE_SUFFIXES:
        tracked = {stream.source for stream in read_sequence(path).poses.values()}
        name = next((usual for usual in (tool, "tool") if usual in tracked), None)
        if name is None:
            listed = ", ".join(sorted(tracked)) or "nothing"
            raise UnreadableFileError(
                f"{path} tracks {listed}, but the recorded tool is '{tool}'; let this tool pivot, or name "
                "the recorded one",
                settings=("tool.name",),
            )
    return replace(read_poses(path, source=name), source="tool")
