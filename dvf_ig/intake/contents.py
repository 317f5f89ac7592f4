"""Contents of a session's files, a line a part, as `config init` and `config validate` print them.

Kernels are loaded only when something is described: a session is read without them.
"""

import numpy as np

from dvf_ig.core import FloatArray, ImageMap, InvalidInputError, LatencyRecording, Points, PoseStream, Rigid
from dvf_ig.core.recordings.phantom import NWireRecording, TargetRecording
from dvf_ig.core.recordings.signal import Respiration, Signal
from dvf_ig.core.space.volume import VolumeSeries
from dvf_ig.core.timing.cycle import CycleTiming
from dvf_ig.core.timing.trigger import TriggerTimes
from dvf_ig.io.image.gated_volume import GatedVolumeFile

from .preop import PreopFiles, preop_label_values
from .readers import StartFiles, Sweep

DARK_BORDER = 0.02
"""A sector leaves at least this share of the image dark."""


def heart_contents(files: PreopFiles | None) -> str | None:
    """Model, grey levels, labels and surfaces."""
    if files is None:
        return None
    preop, model, words = files.preop, files.model, []
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


def ultrasound_contents(sweep: Sweep | None, volumes: tuple[GatedVolumeFile, ...]) -> str | None:
    """Images, their sector and the probe's poses; or the names of gated volumes."""
    if sweep is None:
        names = ", ".join(dict.fromkeys(file.path.name for file in volumes))
        return f"gated volumes {names}" if names else None
    recorded, probe = sweep.recorded, sweep.probe
    if recorded.images is None:
        return f"no images; {_poses(probe)}"
    from dvf_ig.registration.lc2.slices import fan_mask_from_images

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


def ecg_contents(ecg: Signal | TriggerTimes | None) -> str | None:
    """Leads, span and heart rate."""
    if ecg is None:
        return None
    source = "trigger" if isinstance(ecg, TriggerTimes) else f"{', '.join(ecg.leads)} at {ecg.rate_hz:g} Hz"
    return f"{source}, {_span(ecg.t_s)}; {_beats(ecg)}"


def respiration_contents(breathing: Respiration | None) -> str | None:
    """Describe what follows the breath."""
    if breathing is None:
        return None
    rate_hz = (len(breathing) - 1) / float(breathing.t_s[-1] - breathing.t_s[0])
    return f"{breathing.name} at {rate_hz:.0f} Hz, {_span(breathing.t_s)}"


def _beats(ecg: Signal | TriggerTimes) -> str:
    from dvf_ig.cardiac import stream_recording

    try:
        peaks, _ = stream_recording(ecg)
    except InvalidInputError:
        return "no R peaks found"
    if len(peaks) < 2:
        return f"{len(peaks)} R peaks"
    rate_bpm = 60.0 / float(np.median(np.diff([peak.t_s for peak in peaks])))
    return f"{len(peaks)} R peaks, {rate_bpm:.0f} beats/min"


def tool_contents(tool: PoseStream | None, sweep: Sweep | None) -> str | None:
    """The tool's poses, or the tools in the sweep that it may be."""
    if tool is not None:
        return _poses(tool)
    others = () if sweep is None else sweep.other_tools
    return f"one of {', '.join(others)}: say which (tool.name)" if len(others) > 1 else None


def probe_contents(
    probe: ImageMap | NWireRecording | TargetRecording | None, sweep: Sweep | None
) -> str | None:
    """Size of the pixels and of the sweep's images; or the phantom of a recording."""
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


def latency_contents(latency: float | LatencyRecording | None) -> str | None:
    """Seconds, or the length of a recording."""
    if latency is None:
        return None
    if isinstance(latency, float):
        return f"{latency:+.4f} s (time of tracker = time of video + latency)"
    return f"recording of a water tank, {len(latency.wall_row_px.t_s)} images"


def tip_contents(tip: Points | PoseStream | None) -> str | None:
    """Place of the tip, or the poses of a pivot recording."""
    if tip is None:
        return None
    if isinstance(tip, PoseStream):
        return f"pivot recording, {_poses(tip)}"
    place = ", ".join(f"{side:.1f}" for side in tip.xyz_mm[0])
    return f"at ({place}) mm in the tool's own frame"


def device_contents(place: Rigid | None) -> str | None:
    """Place of a haptic device's origin."""
    if place is None:
        return None
    return f"its origin at ({', '.join(f'{side:.1f}' for side in place.translation_mm)}) mm of the tracker"


def start_contents(start: StartFiles) -> str | None:
    """Pose, landmarks with their residual, and touched points."""
    words = []
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
    from dvf_ig.registration import start_from_landmarks

    try:
        residuals = start_from_landmarks(start.landmarks_mr, start.landmarks_tracker).residuals_mm
    except InvalidInputError:
        return ""
    return f", residual {float(np.sqrt((residuals**2).mean())):.1f} mm RMS"
