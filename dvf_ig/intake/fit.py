"""Whether the parts of a session fit each other.

What is not there is told by `missing_parts`, what cannot be read by `examine`.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dvf_ig.cardiac import RPeak, stream_recording
from dvf_ig.core.errors import InvalidInputError, NoOverlapError
from dvf_ig.core.model import DvfModel
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.points import Points
from dvf_ig.intake.agreement.agreement import disagreements
from dvf_ig.intake.agreement.cycle import HeartInImages, heart_in_images
from dvf_ig.intake.agreement.finding import Finding
from dvf_ig.intake.checks import (
    have_common_time,
    require_common_time,
    require_heart_beats,
    require_tracked,
)
from dvf_ig.intake.fit_heart import misfits_of_heart
from dvf_ig.intake.live_read import LivePatient
from dvf_ig.intake.missing import missing_parts
from dvf_ig.intake.parts import SessionParts, StartFiles, Sweep
from dvf_ig.intake.preop import PreopFiles
from dvf_ig.intake.problem import Problem, ProblemList, Use
from dvf_ig.intake.read import SessionRecordings
from dvf_ig.registration import TouchedPoints, start_from_landmarks
from dvf_ig.registration.surface_points.touched import require_spread
from dvf_ig.session.calibrations import require_lag

IMAGE_DEPTH_MM = (10.0, 500.0)
"""Of images of the heart, from intracardiac probes to transthoracic ones, with room to spare."""
LEAST_SHOWN = 0.01
"""A sector smaller than this share of the image is none."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Whether parts can be used together.

    Attributes:
        problems: what single parts, or pairs of them, cannot be used for.
        findings: in what they disagree, refused or not.
        seen: what the images say of the ECG's clock; None where it was not looked at.
    """

    problems: tuple[Problem, ...]
    findings: tuple[Finding, ...]
    seen: HeartInImages | None

    @property
    def misfits(self) -> tuple[Problem, ...]:
        """What keeps parts from being used; where a key is of no use, nothing more is said of it."""
        told = {problem.key for problem in self.problems}
        refused = (one.problem for one in self.findings if one.refused and one.key not in told)
        return (*self.problems, *refused)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """What is doubtful, but not refused."""
        return tuple(one for one in self.findings if not one.refused)


def fit_of(parts: SessionParts) -> Fit:
    """Of the parts that there are."""
    problems, peaks = _misfits(parts)
    peaks_s = np.array([peak.t_s for peak in peaks])
    seen = None if problems else heart_in_images(parts, peaks_s)
    return Fit(tuple(problems), disagreements(parts, peaks_s, seen), seen)


def _misfits(parts: SessionParts) -> tuple[list[Problem], tuple[RPeak, ...]]:
    """What single parts, or pairs of them, cannot be used for; and the heart beats of the ECG."""
    problems, peaks = ProblemList(), tuple[RPeak, ...]()
    sweep, ecg, tool, start = parts.sweep, parts.ecg, parts.tool, parts.start
    if sweep is not None:
        with problems.about("ultrasound"):
            _require_images(sweep)
            require_tracked(sweep.probe, "ultrasound")
        with problems.about("ultrasound.fan"):
            _require_sector(parts, sweep)
        with problems.about("calibration.probe"):
            _require_depth(parts, sweep)
    if ecg is not None:
        with problems.about("ecg"):
            peaks, _ = stream_recording(ecg)
            require_heart_beats(peaks, ecg)
    if tool is not None:
        with problems.about("tool", "replay"):
            require_tracked(tool, "tool")
    problems.found += _clock_misfits(parts)
    if isinstance(parts.latency, float):
        with problems.about("calibration.latency"):
            require_lag(parts.latency)
    with problems.about("start.landmarks_tracker"):
        if start.landmarks_mr is not None and start.landmarks_tracker is not None:
            start_from_landmarks(start.landmarks_mr, start.landmarks_tracker)
    with problems.about("start.touched"):
        if start.touched is not None:
            require_spread(TouchedPoints(start.touched, np.zeros(len(start.touched))))
    if parts.preop is not None:
        problems.found += misfits_of_heart(parts.preop)
    return problems.found, peaks


def require_fit(recordings: SessionRecordings, use: Use) -> tuple[Finding, ...]:
    """What is doubtful about recordings that were read.

    Raises:
        DvfIgError: the first reason why they cannot be used for something.
    """
    parts = parts_of(recordings)
    fit = fit_of(parts)
    _refuse((*fit.misfits, *missing_parts(parts)), use)
    return tuple(one for one in fit.warnings if one.concerns(use))


def require_live_fit(
    patient: LivePatient, model: DvfModel, image: ImageMap, lag_s: float, tip: Points
) -> tuple[Finding, ...]:
    """What is doubtful about the files of a live session, which sends the rest.

    Args:
        model: of the patient.
        image, lag_s, tip: calibrations in use.
    Raises:
        DvfIgError: the first reason why they cannot be used, or not together.
    """
    start = StartFiles(patient.start, patient.landmarks_mr, patient.landmarks_tracker, patient.touched)
    heart = PreopFiles(patient.preop, model, patient.named_patient)
    fit = fit_of(SessionParts(heart, fan=patient.fan, probe=image, latency=lag_s, tip=tip, start=start))
    _refuse(fit.misfits, "replay")
    return fit.warnings


def _refuse(problems: Iterable[Problem], use: Use) -> None:
    for problem in problems:
        if problem.concerns(use):
            raise type(problem.error)(problem.sentence) from problem.error


def parts_of(recordings: SessionRecordings) -> SessionParts:
    """The same recordings, part by part."""
    scenario = recordings.scenario
    return SessionParts(
        PreopFiles(scenario.preop, recordings.model, recordings.named_patient),
        Sweep(scenario.ultrasound, scenario.ultrasound.stream("tracker", "probe")),
        scenario.fan,
        scenario.ecg,
        scenario.tool,
        scenario.probe,
        scenario.latency,
        scenario.tip,
        StartFiles(scenario.start, scenario.landmarks_mr, scenario.landmarks_tracker, scenario.touched),
    )


def _clock_misfits(parts: SessionParts) -> list[Problem]:
    """Of ECG, ultrasound and tool the one that shares no time with the others; without a tool, the ECG."""
    problems = ProblemList()
    if parts.ecg is None:
        return []
    ecg_s = parts.ecg.t_s
    tool_fits = parts.tool is not None and have_common_time(ecg_s, parts.tool.t_s)
    sweep_s = None if parts.sweep is None else parts.sweep.recorded.t_s
    if sweep_s is not None:
        with problems.about("ultrasound" if tool_fits else "ecg"):
            try:
                require_common_time(parts.ecg, sweep_s, "ultrasound")
            except NoOverlapError as exc:
                raise NoOverlapError(f"{exc}, and --ecg-start says when on it the ECG began") from exc
    if parts.tool is not None and not problems.found:
        with problems.about("tool", "replay"):
            require_common_time(parts.ecg, parts.tool.t_s, "tool")
    return problems.found


def _require_images(sweep: Sweep) -> None:
    recorded = sweep.recorded
    if recorded.images is None:
        raise InvalidInputError(
            "the recording has poses but no images; record the ultrasound's video with them"
        )
    if not recorded.has_timestamps:
        raise InvalidInputError(
            "the frames have no time stamps, so that no image can be placed in the cardiac cycle; record "
            "with them (PLUS does)"
        )
    if not recorded.images[:: max(1, len(recorded) // 50)].any():
        raise InvalidInputError("every image is black; check the video input and record again")


def _require_sector(parts: SessionParts, sweep: Sweep) -> None:
    if parts.fan is None or sweep.recorded.images is None:
        return
    rows, columns = sweep.recorded.images.shape[1:]
    share = float(parts.fan.mask(rows, columns).mean())
    if share < LEAST_SHOWN:
        raise InvalidInputError(
            f"the sector covers {share:.1%} of the images of {columns} x {rows} px; give it in pixels of "
            "these images and rad, or leave it out: it is then found in the images"
        )


def _require_depth(parts: SessionParts, sweep: Sweep) -> None:
    if not isinstance(parts.probe, ImageMap) or sweep.recorded.images is None:
        return
    least, most = IMAGE_DEPTH_MM
    rows = sweep.recorded.images.shape[1]
    depth_mm = rows * float(parts.probe.scale_mm_per_px[1])
    if not least <= depth_mm <= most:
        raise InvalidInputError(
            f"its pixels are {parts.probe.scale_mm_per_px[1]:.3g} mm high, so that the images of {rows} rows "
            f"would be {depth_mm:.3g} mm deep; needed {least:g} to {most:g} mm: calibrate with images of "
            "this size, in mm"
        )
