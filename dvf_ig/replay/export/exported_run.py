"""Folder that `replay` or `register` wrote, with its recording, as exports need it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import (
    BoolArray,
    FloatArray,
    ImageMap,
    IntArray,
    InvalidInputError,
    Points,
    Rigid,
    Scenario,
    UnreadableFileError,
    Warp,
)
from dvf_ig.core.space.frames import RAS_FROM_LPS
from dvf_ig.intake.calibrations import calibrate
from dvf_ig.io import provenance_fields, read_json, read_sequence
from dvf_ig.replay.outputs import POSES, read_shape
from dvf_ig.replay.run_folder import RESULT, require_same_recording
from dvf_ig.replay.ticks import POSE_STEP_S
from dvf_ig.session import UltrasoundCalibration


@dataclass(frozen=True, slots=True, eq=False)
class ExportedRun:
    """Run or registration of a recorded intervention.

    Attributes:
        scenario: the recording.
        ultrasound: ultrasound calibration in use.
        tip: tool tip in frame "tool"; None if not known.
        poses: (time, mr_from_tracker of that moment, motion in breathing included), at most POSE_STEP_S apart
            while it moves; a registration has one, at minus infinity.
        suspended_s: spans in which no pose was in use.
        bound_mm: bound of the last usable registration's error over the heart with 95 % probability; None if
            none was stated.
        result: the content of result.json.
        warp: change of the heart's shape at the last pose; None if it has kept its shape.
    """

    scenario: Scenario
    ultrasound: UltrasoundCalibration
    tip: Points | None
    poses: tuple[tuple[float, Rigid], ...]
    suspended_s: tuple[tuple[float, float], ...]
    bound_mm: float | None
    result: dict[str, Any]
    warp: Warp | None = None

    def pose_numbers(self, t_s: FloatArray) -> IntArray:
        """Find (n,) the index in `poses` of the pose at `t_s`, or of the last before; at least the first."""
        begin = np.array([from_s for from_s, _ in self.poses])
        by_s = t_s + 0.5 * POSE_STEP_S
        return np.maximum(np.searchsorted(begin, by_s, side="right") - 1, 0).astype(np.int64)

    def suspended(self, t_s: FloatArray) -> BoolArray:
        """Return (n,) whether the pose was suspended at `t_s`."""
        inside = np.zeros(len(t_s), dtype=np.bool_)
        for begin_s, end_s in self.suspended_s:
            inside |= (t_s >= begin_s) & (t_s < end_s)
        return inside


def read_exported_run(folder: Path, scenario: Scenario) -> ExportedRun:
    """Read the folder that `dvf-ig replay` or `dvf-ig register` wrote, and its recording.

    Args:
        scenario: the recording that the folder was made from; if a record of inputs is open, the files read
            for it are compared with those that the result lists.
    Raises:
        UnreadableFileError: no such folder, or a damaged one.
        InvalidInputError: no usable pose, a registration of a pair of images, or another recording.
    """
    path = folder / RESULT
    if not path.is_file():
        raise UnreadableFileError(
            f"{folder} has no {RESULT}; give the folder that `dvf-ig replay` or `dvf-ig register` wrote"
        )
    result = read_json(path, "a result")
    if not isinstance(result, dict) or "moving_from_fixed" in result:
        raise InvalidInputError(
            f"{folder} is not a run or registration of a recorded intervention; a pair of images needs no "
            "scene: load both and the .tfm (guide, 3D Slicer)"
        )
    require_same_recording(result, folder, provenance_fields().get("inputs", []))
    try:
        if "mr_from_tracker" in result:
            return _registration(folder, result, scenario)
        return _replayed(folder, result, scenario)
    except (KeyError, TypeError, AttributeError) as exc:
        raise UnreadableFileError(f"{path} is damaged or of another version ({exc}); run again") from exc


def _replayed(folder: Path, result: dict[str, Any], scenario: Scenario) -> ExportedRun:
    estimates, usable = result["estimates"], [one for one in result["registrations"] if one["usable"]]
    if not usable:
        raise InvalidInputError(f"{folder} holds no usable registration, so nothing can be placed")
    image = ImageMap.from_matrix(estimates["probe_from_image"], "probe")
    return ExportedRun(
        scenario,
        UltrasoundCalibration(image, float(estimates["lag_s"])),
        Points("tool", np.array([estimates["tip_mm"]])),
        _poses(folder / POSES),
        tuple((float(begin), float(end)) for begin, end in result["doubts_s"]),
        usable[-1]["tre_bound_mm"],
        result,
        read_shape(folder),
    )


def _registration(folder: Path, result: dict[str, Any], scenario: Scenario) -> ExportedRun:
    if not result["stop"] == "CONVERGED":
        raise InvalidInputError(f"{folder}: the registration must not be used: {result['reason']}")
    calibrations = calibrate(replace(scenario, tip=None), int(result["seed"]))
    pose = Rigid.from_matrix(np.array(result["mr_from_tracker"]), "mr", "tracker")
    bound = result["tre_bound_mm"]
    placed = ((-np.inf, pose),)
    return ExportedRun(scenario, calibrations.ultrasound, None, placed, (), bound, result, read_shape(folder))


def _poses(path: Path) -> tuple[tuple[float, Rigid], ...]:
    """Read (time, mr_from_tracker) from `poses.seq.mha`, with any PLUS name for the tracker."""
    streams = list(read_sequence(path).poses.values())
    if len(streams) != 1 or streams[0].target != "ras":
        raise UnreadableFileError(f"{path} is not the pose sequence of a replay; replay again")
    stream = streams[0]
    matrices = np.tile(np.eye(4), (len(stream), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = stream.rotations, stream.translations_mm
    return tuple(
        (t_s, Rigid.from_matrix(RAS_FROM_LPS @ matrix, "mr", "tracker"))
        for t_s, matrix in zip(stream.t_s.tolist(), matrices, strict=True)
    )
