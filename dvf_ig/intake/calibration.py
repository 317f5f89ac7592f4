"""The calibrations of a session: results from files, or the recordings they are made from."""

from dataclasses import replace
from pathlib import Path

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.recordings.phantom import NWireRecording, TargetRecording
from dvf_ig.core.recordings.scenario import LatencyRecording
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.points import Points
from dvf_ig.core.space.rigid import Rigid
from dvf_ig.intake.schema import LatencyConfig, NWireConfig, PivotConfig, TargetConfig
from dvf_ig.io.calibration_files import read_lag, read_probe, read_tip
from dvf_ig.io.plus.feature_points import read_target_recording
from dvf_ig.io.plus.latency import read_latency_recording
from dvf_ig.io.plus.names import ProbeNames, same_sensor
from dvf_ig.io.plus.nwire import read_nwire_recording
from dvf_ig.io.plus.poses import SEQUENCE_SUFFIXES, read_poses
from dvf_ig.io.plus.sequence_read import read_sequence


def read_probe_source(
    source: str | NWireConfig | TargetConfig, folder: Path, names: ProbeNames
) -> ImageMap | NWireRecording | TargetRecording:
    """probe_from_image, or the sweep of a phantom.

    Args:
        names: of probe and reference in the recordings; the result's frame is "probe" whatever its name.
    """
    if isinstance(source, str):
        found = read_probe(folder / source, names.probe)
        rigid = found.rigid
        placed = Rigid("probe", rigid.source, rigid.rotation, rigid.translation_mm)
        return ImageMap(placed, found.scale_mm_per_px, found.shear_deg)
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
            "name the recorded one (tool.name)"
        )
    return Points("tool", tip.xyz_mm)


def _pivoting(path: Path, tool: str) -> PoseStream:
    """Poses of this tool, whatever else was tracked while it pivoted; one that is just "tool" is any tool."""
    name = None
    if tool != "tool" and path.suffix.lower() in SEQUENCE_SUFFIXES:
        tracked = {stream.source for stream in read_sequence(path).poses.values()}
        name = next((known for known in (tool, "tool") if known in tracked), None)
        if name is None:
            listed = ", ".join(sorted(tracked)) or "nothing"
            raise UnreadableFileError(
                f"{path} tracks {listed}, but the recorded tool is '{tool}'; let this tool pivot, or name "
                "the recorded one (tool.name)"
            )
    return replace(read_poses(path, source=name), source="tool")
