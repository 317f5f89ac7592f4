"""Whether the parts of a session can be used, and used together.

What is not there is said by `missing_parts`, what cannot be read by `examine`.
"""

from collections.abc import Sized
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dvf_ig.cardiac import MIN_BEATS, RPeak, stream_recording
from dvf_ig.core import FloatArray, Grid, ImageMap, PoseStream, Preop, Signal, TouchedPoints, TriggerTimes
from dvf_ig.core.errors import InvalidInputError, NoOverlapError
from dvf_ig.registration import start_from_landmarks
from dvf_ig.registration.surface_points.touched import require_spread
from dvf_ig.session.setup import require_lag

from .agreement import disagreements
from .findings import Finding
from .heart_in_images import HeartInImages, heart_in_images
from .parts import SessionFiles, missing_parts
from .preop import PreopFiles, preop_label_values
from .problems import Problem, ProblemList, Use
from .readers import Sweep

IMAGE_DEPTH_MM = (10.0, 500.0)
"""Depth of images of the heart, from intracardiac probes to transthoracic ones, with room to spare."""
LEAST_SHOWN = 0.01
"""A sector smaller than this share of the image is none."""
LEAST_INSIDE = 0.5
"""Share of a model's surface in the images that it goes with; a cine may cut off apex or base."""
LEAST_COMMON_S = 1.0
FILE_OF = {"preop.organ_labels": "preop.labels", "preop.surface": "preop.surfaces_folder"}
"""Keys that name the file whose content another key is about."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Whether parts can be used together.

    Attributes:
        problems: what single parts, or pairs of them, cannot be used for.
        findings: in what they disagree, refused or not.
        seen: what the images say of the ECG's clock; None if it was not looked at.
        named: files by their keys.
    """

    problems: tuple[Problem, ...]
    findings: tuple[Finding, ...]
    seen: HeartInImages | None
    named: dict[str, Path] = field(default_factory=dict)

    @property
    def misfits(self) -> tuple[Problem, ...]:
        """Problems that prevent a use; a key that is unusable is named once."""
        keys = {problem.key for problem in self.problems}
        refused = (one.problem for one in self.findings if one.refused and one.key not in keys)
        return tuple(self._with_file(problem) for problem in (*self.problems, *refused))

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Findings that are doubtful, but not refused."""
        return tuple(one for one in self.findings if not one.refused)

    def _with_file(self, problem: Problem) -> Problem:
        """Name the file that a problem concerns, if there is one."""
        key = problem.key
        of_file = next((k for k in (key, f"{key}.file", FILE_OF.get(key)) if k in self.named), None)
        if of_file is None:
            return problem
        path, error = self.named[of_file], problem.error
        key = key if of_file == FILE_OF.get(key) else of_file
        named = type(error)(f"{path}: {error.message}", key=key, path=path, settings=error.settings)
        return Problem(key, named, problem.hinders)


def fit_of(files: SessionFiles) -> Fit:
    """Check the parts that there are."""
    problems, peaks = _misfits(files)
    peaks_s = np.array([peak.t_s for peak in peaks])
    seen = None if problems else heart_in_images(files, peaks_s)
    return Fit(tuple(problems), disagreements(files, peaks_s, seen), seen, dict(files.named))


def require_fit(files: SessionFiles, use: Use) -> tuple[Finding, ...]:
    """Check a session's files for a use, and return what is doubtful.

    Raises:
        DvfIgError: the first reason why they cannot be used for it, with its key.
    """
    fit = fit_of(files)
    for problem in (*fit.misfits, *missing_parts(files)):
        if problem.concerns(use):
            raise problem.error
    return tuple(one for one in fit.warnings if one.concerns(use))


def require_live_fit(files: SessionFiles) -> tuple[Finding, ...]:
    """Check the files that a live session begins with, its calibrations as they are used.

    Raises:
        DvfIgError: the first reason why they cannot be used, or not together, with its key.
    """
    fit = fit_of(files)
    for problem in fit.misfits:
        raise problem.error
    return fit.warnings


def require_tracked(stream: PoseStream, what: str) -> None:
    """Raise InvalidInputError where not one pose is valid.

    Args:
        what: was recorded, for example "tool".
    """
    if not stream.valid.any():
        raise InvalidInputError(
            f"{what} recording: none of the {len(stream)} poses of {stream.name} has status OK; "
            "check the line of sight and record again"
        )


def have_common_time(first_s: FloatArray, second_s: FloatArray) -> bool:
    """Whether two recordings share at least LEAST_COMMON_S, by their (n,) and (m,) increasing times."""
    begin, end = max(float(first_s[0]), float(second_s[0])), min(float(first_s[-1]), float(second_s[-1]))
    return end - begin >= LEAST_COMMON_S


def require_common_time(beats: Signal | TriggerTimes, other_s: FloatArray, what: str) -> None:
    """Raise NoOverlapError where the ECG, or a trigger, and another recording share less than LEAST_COMMON_S.

    Args:
        other_s: (n,) increasing times.
        what: the other is, for example "tool".
    """
    ecg_s = beats.t_s
    if not have_common_time(ecg_s, other_s):
        source = "trigger" if isinstance(beats, TriggerTimes) else "ECG"
        raise NoOverlapError(
            f"{source} ({ecg_s[0]:.1f} to {ecg_s[-1]:.1f} s) and {what} ({other_s[0]:.1f} to "
            f"{other_s[-1]:.1f} s) share less than a second; they must be on one clock"
        )


def require_heart_beats(peaks: Sized, ecg: Signal | TriggerTimes) -> None:
    """Raise InvalidInputError where ECG or trigger shows too few R peaks."""
    if len(peaks) >= MIN_BEATS:
        return
    if isinstance(ecg, TriggerTimes):
        raise InvalidInputError(
            f"the trigger gives {len(peaks)} beats of {len(ecg)} pulses, needed at least {MIN_BEATS}; "
            "check its cable, and that each beat gives one pulse"
        )
    raise InvalidInputError(
        f"the ECG has {len(peaks)} R peaks in {len(ecg) / ecg.rate_hz:.0f} s on lead(s) "
        f"{', '.join(ecg.leads)}, needed at least {MIN_BEATS}; check the electrodes and the lead"
    )


def _misfits(files: SessionFiles) -> tuple[list[Problem], tuple[RPeak, ...]]:
    """Problems of single parts and of pairs of them; and the heart beats of the ECG."""
    problems, peaks = ProblemList(), tuple[RPeak, ...]()
    sweep, ecg, tool, start = files.sweep, files.ecg, files.tool, files.start
    if sweep is not None:
        with problems.about("ultrasound"):
            _require_images(sweep)
            require_tracked(sweep.probe, "ultrasound")
        with problems.about("ultrasound.fan"):
            _require_sector(files, sweep)
        with problems.about("calibration.probe"):
            _require_depth(files, sweep)
    if files.volumes:
        problems.items += _volume_misfits(files)
    if ecg is not None:
        with problems.about("ecg"):
            peaks, _ = stream_recording(ecg)
            require_heart_beats(peaks, ecg)
    if tool is not None:
        with problems.about("tool", "replay"):
            require_tracked(tool, "tool")
    problems.items += _clock_misfits(files)
    if isinstance(files.latency, float):
        with problems.about("calibration.latency"):
            require_lag(files.latency)
    with problems.about("start.landmarks_tracker"):
        if start.landmarks_mr is not None and start.landmarks_tracker is not None:
            start_from_landmarks(start.landmarks_mr, start.landmarks_tracker)
    with problems.about("start.touched"):
        if start.touched is not None:
            require_spread(TouchedPoints(start.touched, np.zeros(len(start.touched))))
    if files.preop is not None:
        problems.items += _heart_misfits(files.preop)
    return problems.items, peaks


def _volume_misfits(files: SessionFiles) -> list[Problem]:
    """Problems of gated volumes with other parts."""
    problems = ProblemList()
    with problems.about("ultrasound.volumes"):
        if files.sweep is not None:
            raise InvalidInputError("a session has a tracked sweep or gated volumes; give one of them")
    with problems.about("ultrasound.file", "replay"):
        if files.sweep is None:
            raise InvalidInputError("gated volumes give a pose but no force; a replay needs a tracked sweep")
    with problems.about("ecg"):
        if files.ecg is not None and not any(file.t_s is not None for file in files.volumes):
            raise InvalidInputError("it belongs to volumes given as FILE=SECONDS; every one has its phase")
        if isinstance(files.ecg, TriggerTimes):
            raise InvalidInputError("volumes given as FILE=SECONDS need an ECG, not a trigger")
    with problems.about("start.touched"):
        if files.start.touched is not None:
            raise InvalidInputError("points are touched for a tracked sweep; volumes start from landmarks")
    return problems.items


def _heart_misfits(heart: PreopFiles) -> list[Problem]:
    """Problems among model, images, labels and surfaces."""
    problems = ProblemList()
    preop, model = heart.preop, heart.model
    if preop.surfaces and model is None:
        names = [series.name for series in preop.surfaces]
        with problems.about("preop.surface"):
            if preop.surface not in names:
                raise InvalidInputError(
                    f"there is no surface '{preop.surface}'; name one of {', '.join(names)}"
                )
    if preop_label_values(preop):
        with problems.about("preop.organ_labels"):
            _require_labels(preop)
    if preop.mr is not None and preop.labels is not None:
        with problems.about("preop.labels"):
            if len(preop.mr.timing) != len(preop.labels.timing):
                raise InvalidInputError(
                    f"the labels have {len(preop.labels.timing)} phases, the grey levels (mr) have "
                    f"{len(preop.mr.timing)}; needed as many, or labels of end-diastole alone"
                )
    if preop.mr is not None and model is not None:
        with problems.about("preop.mr"):
            _require_inside(model.reference[model.ed_phase].vertices_mm, preop.mr.grid)
    return problems.items


def _require_labels(preop: Preop) -> None:
    there = preop_label_values(preop)
    listed = ", ".join(map(str, there)) or "none"
    absent = sorted(set(preop.organ_labels) - set(there))
    if preop.organ_labels and len(absent) == len(set(preop.organ_labels)):
        raise InvalidInputError(
            f"the image has none of the labels {', '.join(map(str, absent))}; it has {listed}"
        )


def _require_inside(vertices_mm: FloatArray, grid: Grid) -> None:
    inside = float(grid.holds(grid.to_index(vertices_mm), margin=0.5).mean())
    if inside < LEAST_INSIDE:
        raise InvalidInputError(
            f"{inside:.0%} of the model's surface lies in these images, needed {LEAST_INSIDE:.0%}; give the "
            "images that the model was built from"
        )


def _clock_misfits(files: SessionFiles) -> list[Problem]:
    """Find which of ECG, ultrasound and tool shares no time with the others; without a tool, the ECG."""
    problems = ProblemList()
    if files.ecg is None:
        return []
    ecg_s = files.ecg.t_s
    tool_fits = files.tool is not None and have_common_time(ecg_s, files.tool.t_s)
    sweep_s = None if files.sweep is None else files.sweep.recorded.t_s
    if sweep_s is not None:
        with problems.about("ultrasound" if tool_fits else "ecg"):
            try:
                require_common_time(files.ecg, sweep_s, "ultrasound")
            except NoOverlapError as exc:
                raise NoOverlapError(
                    f"{exc.message}; say when on it the ECG began", settings=("ecg.start_s",)
                ) from exc
    if files.tool is not None and not problems.items:
        with problems.about("tool", "replay"):
            require_common_time(files.ecg, files.tool.t_s, "tool")
    return problems.items


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


def _require_sector(files: SessionFiles, sweep: Sweep) -> None:
    if files.fan is None or sweep.recorded.images is None:
        return
    rows, columns = sweep.recorded.images.shape[1:]
    share = float(files.fan.mask(rows, columns).mean())
    if share < LEAST_SHOWN:
        raise InvalidInputError(
            f"the sector covers {share:.1%} of the images of {columns} x {rows} px; give it in pixels of "
            "these images and rad, or leave it out: it is then found in the images"
        )


def _require_depth(files: SessionFiles, sweep: Sweep) -> None:
    if not isinstance(files.probe, ImageMap) or sweep.recorded.images is None:
        return
    least, most = IMAGE_DEPTH_MM
    rows = sweep.recorded.images.shape[1]
    depth_mm = rows * float(files.probe.scale_mm_per_px[1])
    if not least <= depth_mm <= most:
        raise InvalidInputError(
            f"its pixels are {files.probe.scale_mm_per_px[1]:.3g} mm high, so that the images of {rows} rows "
            f"would be {depth_mm:.3g} mm deep; needed {least:g} to {most:g} mm: calibrate with images of "
            "this size, in mm"
        )
