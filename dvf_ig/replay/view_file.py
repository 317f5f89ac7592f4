"""Reader and writer of `view.json`: what `dvf-ig view` needs in addition to result and ticks.

It names the recording, the model and the beats, and holds the pose over time; pictures and surfaces are not
copied.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import CycleTiming, DvfModel, FloatArray, UnreadableFileError, read_only_arrays
from dvf_ig.guidance import PathTarget
from dvf_ig.intake.fixtures import STRUCTURES, structure_files
from dvf_ig.io import read_json, read_model, write_model, write_sidecar
from dvf_ig.io.file_within import path_within
from dvf_ig.kernels.servo.layout import MAX_FIXTURES

from .engine import Replay

VIEW = "view.json"
STRUCTURE_FILES = tuple(f"{STRUCTURES}{k}.npz" for k in range(MAX_FIXTURES))
KIND = "view"
_AT = 0.01
"""Share of the way to a stored pose within which it applies, as none exists before the first."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ViewFile:
    """The content of `view.json`.

    Attributes:
        recording: scenario folder or session.yaml that was replayed.
        paths: path of each fixture, in order; None for one on the surface.
        structures: structure of each fixture, in order; None for one on the heart.
        model: file of the model; None if the recording names it or it was built.
        r_peaks_s: (k,) R peaks that were detected.
        pose_t_s: (m,) times of the poses, tracker clock.
        mr_from_tracker: (m, 3, 4); NaN if none was in use.
    """

    recording: Path
    model: Path | None
    paths: tuple[PathTarget | None, ...]
    structures: tuple[DvfModel | None, ...]
    r_peaks_s: FloatArray
    pose_t_s: FloatArray
    mr_from_tracker: FloatArray

    def pose_at(self, t_s: FloatArray) -> FloatArray:
        """Interpolate (n, 3, 4) poses at (n,) times linearly; NaN if none was in use."""
        right = np.clip(np.searchsorted(self.pose_t_s, t_s), 1, len(self.pose_t_s) - 1)
        first, last = self.pose_t_s[right - 1], self.pose_t_s[right]
        weight = np.clip((t_s - first) / (last - first), 0.0, 1.0)[:, None, None]
        before, after = self.mr_from_tracker[right - 1], self.mr_from_tracker[right]
        between = (1 - weight) * before + weight * after
        return np.asarray(np.where(weight < _AT, before, np.where(weight > 1 - _AT, after, between)))


def write_view_file(replay: Replay, folder: Path, run: Path, recording: Path, model: Path | None) -> None:
    """Write `view.json`, and the models of further structures next to it.

    Args:
        folder: folder to write to; `run` is its final name, to which paths are relative.
        recording: scenario folder or session.yaml.
        model: model file given by the user.
    Raises:
        OutputError: not writable.
    """
    structures = structure_files(replay.setup.fixtures)
    for name, structure in structures.items():
        write_model(structure, folder / name)
    names = {id(structure): name for name, structure in structures.items()}
    t_s, poses = replay.ticks.thinned_poses()
    rows = [row if np.isfinite(row).all() else None for row in poses.reshape(-1, 12).round(9)]
    content = {
        "recording": _relative(recording, run),
        "model": None if model is None else _relative(model, run),
        "paths": [_path(one.path) for one in replay.setup.fixtures.fixtures],
        "structures": [names.get(id(one.structure)) for one in replay.setup.fixtures.fixtures],
        "r_peaks_s": [round(peak.t_s, 6) for peak in replay.history.peaks],
        "poses": {"t_s": t_s.round(6), "mr_from_tracker": rows},
    }
    write_sidecar(folder / VIEW, content, KIND)


def read_view_file(run: Path) -> ViewFile:
    """Read `view.json` of a replay's folder.

    Raises:
        UnreadableFileError: absent or damaged.
    """
    path = run / VIEW
    if not path.is_file():
        raise UnreadableFileError(
            f"{run} has no {VIEW}, which records what was replayed; replay again with this version "
            f"(dvf-ig replay … -o {run})"
        )
    content = read_json(path, "a replay's view file")
    try:
        structures = content.get("structures", [None] * len(content["paths"]))
        models = {name: read_model(path_within(run, name, path)) for name in set(structures) - {None}}
        rows = [[np.nan] * 12 if row is None else row for row in content["poses"]["mr_from_tracker"]]
        return ViewFile(
            recording=_place(run, content["recording"]),
            model=None if content["model"] is None else _place(run, content["model"]),
            paths=tuple(None if one is None else _path_target(one) for one in content["paths"]),
            structures=tuple(None if one is None else models[one] for one in structures),
            r_peaks_s=_floats(content["r_peaks_s"]),
            pose_t_s=_floats(content["poses"]["t_s"]),
            mr_from_tracker=_floats(rows).reshape(-1, 3, 4),
        )
    except (KeyError, TypeError, ValueError) as exc:
        raise UnreadableFileError(f"{path} is damaged ({exc}); replay again") from exc


def _path(path: PathTarget | None) -> dict[str, Any] | None:
    if path is None:
        return None
    timing = path.timing
    return {
        "frame": path.frame,
        "points_mm": path.points_mm,
        "fractions": None if timing is None else timing.fractions,
        "rr_s": None if timing is None else timing.rr_s,
    }


def _path_target(content: dict[str, Any]) -> PathTarget:
    moving = content["fractions"] is not None
    timing = CycleTiming(_floats(content["fractions"]), content["rr_s"]) if moving else None
    return PathTarget(content["frame"], _floats(content["points_mm"]), timing)


def _floats(values: Any) -> FloatArray:
    return np.asarray(values, dtype=np.float64)


def _relative(path: Path, run: Path) -> str:
    """Make a path relative: both may move together, and no parent folder is disclosed."""
    return Path(os.path.relpath(path.resolve(), run.resolve())).as_posix()


def _place(run: Path, relative: str) -> Path:
    return Path(os.path.normpath(run / relative))
