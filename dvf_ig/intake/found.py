"""What the files of a session hold, a line a part."""

import numpy as np

from dvf_ig.cardiac import stream_recording
from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.recordings.phantom import NWireRecording
from dvf_ig.core.recordings.signal import Signal
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.points import Points
from dvf_ig.core.space.volume import VolumeSeries
from dvf_ig.core.timing.cycle import CycleTiming
from dvf_ig.core.timing.trigger import TriggerTimes
from dvf_ig.intake.fit_heart import preop_label_values
from dvf_ig.intake.parts import SessionParts, StartFiles, Sweep
from dvf_ig.intake.preop import PreopFiles
from dvf_ig.registration import start_from_landmarks
from dvf_ig.registration.lc2.slices import fan_mask_from_images

DARK_BORDER = 0.02
"""A sector leaves at least this share of the image dark."""


def found(parts: SessionParts) -> dict[str, str | None]:
    """By the key of each part what was found; None where it is not there."""
    sweep = parts.sweep
    return {
        "preop": None if parts.preop is None else _heart(parts.preop),
        "ultrasound": None if sweep is None else _ultrasound(sweep),
        "ecg": None if parts.ecg is None else _ecg(parts.ecg),
        "tool": _tool(parts),
        "calibration.probe": _probe(parts),
        "calibration.latency": _latency(parts),
        "calibration.tip": _tip(parts.tip),
        "start": _start(parts.start),
    }


def _heart(files: PreopFiles) -> str:
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
    """ "1 to 4" where none is left out, else one by one."""
    if len(values) > 2 and values[-1] - values[0] == len(values) - 1:
        return f"{values[0]} to {values[-1]}"
    return ", ".join(map(str, values)) or "none"


def _phases(timing: CycleTiming) -> str:
    assumed = " (times assumed: no timing.json)" if timing.timing_assumed and timing.rr_assumed else ""
    return f"{len(timing)} phases{assumed}"


def _size(series: VolumeSeries) -> str:
    shape = " x ".join(map(str, series.grid.shape))
    return f"{shape} voxels of {' x '.join(f'{side:.2g}' for side in series.grid.spacing_mm)} mm"


def _ultrasound(sweep: Sweep) -> str:
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


def _ecg(ecg: Signal | TriggerTimes) -> str:
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


def _tool(parts: SessionParts) -> str | None:
    if parts.tool is not None:
        return _poses(parts.tool)
    others = () if parts.sweep is None else parts.sweep.other_tools
    return f"which is it: {', '.join(others)}? (tool.name)" if len(others) > 1 else None


def _probe(parts: SessionParts) -> str | None:
    probe, sweep = parts.probe, parts.sweep
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


def _latency(parts: SessionParts) -> str | None:
    if parts.latency is None:
        return None
    if isinstance(parts.latency, float):
        return f"{parts.latency:+.4f} s (time of tracker = time of video + latency)"
    return f"recording of a water tank, {len(parts.latency.wall_row_px.t_s)} images"


def _tip(tip: Points | PoseStream | None) -> str | None:
    if tip is None:
        return None
    if isinstance(tip, PoseStream):
        return f"pivot recording, {_poses(tip)}"
    place = ", ".join(f"{side:.1f}" for side in tip.xyz_mm[0])
    return f"at ({place}) mm in the tool's own frame"


def _start(start: StartFiles) -> str | None:
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
    try:
        residuals = start_from_landmarks(start.landmarks_mr, start.landmarks_tracker).residuals_mm
    except InvalidInputError:
        return ""
    return f", residual {float(np.sqrt((residuals**2).mean())):.1f} mm RMS"
