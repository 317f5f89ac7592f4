"""Files of a replay for other programs: pose (ITK, PLUS), poses over time (3D Slicer), shape, every tick."""

import base64
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dvf_ig.cardiac.respiration import BreathState
from dvf_ig.core import IntArray, InvalidInputError, Rigid, UnreadableFileError, Warp
from dvf_ig.core.arrays import AnyArray
from dvf_ig.core.space.warp import COEFFICIENTS
from dvf_ig.guidance import Hazard, Status, SupervisorState
from dvf_ig.io import (
    read_json,
    write_pose_sequence,
    write_registration,
    write_sidecar,
    write_text,
    write_transforms,
)
from dvf_ig.session import UNFOLLOWED

from .ticks import Ticks

POSE, POSES, TICKS, SHAPE = "mr_from_tracker", "poses.seq.mha", "ticks.csv", "shape.json"
NAMES = (f"{POSE}.tfm", f"{POSE}.h5", f"{POSE}.json", f"{POSE}.xml", POSES, TICKS, SHAPE)
"""Names of all files that may be written."""

COLUMNS = (
    ("t_s", "%.6f"),
    ("phi", "%.6f"),
    ("phase_valid", "%d"),
    ("model_phase", "%.6f"),
    ("rr_s", "%.6f"),
    *((f"tip_tracker_{axis}_mm", "%.4f") for axis in "xyz"),
    *((f"tip_mr_{axis}_mm", "%.4f") for axis in "xyz"),
    ("distance_mm", "%.4f"),
    *((f"force_tracker_{axis}_n", "%.6f") for axis in "xyz"),
    ("status", "%s"),
    ("supervisor", "%s"),
    ("hazards", "%s"),
    ("pose_age_s", "%.3f"),
    ("pose_bound_mm", "%.3f"),
    ("margin_mm", "%.4f"),
    ("breath_phase", "%.6f"),
    ("breath_mm", "%.4f"),
    ("breath_state", "%s"),
)
"""Columns of the ticks, each with its format: 1 µs, 0.1 µm, 1 µN."""
_HEADER = ",".join(name for name, _ in COLUMNS)


def write_outputs(
    poses: Sequence[tuple[float, Rigid]],
    ticks: Ticks,
    folder: Path,
    tracked_against: str = "tracker",
    warp: Warp | None = None,
) -> dict[str, str]:
    """Write the last pose in use, the published poses over time and its change of shape, and the ticks.

    Args:
        poses: (time from which it was in use, mr_from_tracker) in order of time; of the heart at rest in
            breathing.
        ticks: ticks of the replay.
        folder: existing folder.
        tracked_against: PLUS's name of the frame that poses are relative to, for the files that it reads.
        warp: change of the heart's shape at the last pose; None if it has kept its shape.
    Returns:
        files written: name, and frame of the content.
    Raises:
        OutputError: not writable.
    """
    frames = {}
    if poses:
        pose = poses[-1][1]
        for path in write_transforms(pose, folder / NAMES[0]):
            frames[path.name] = pose.name
        frames[f"{POSE}.json"] = pose.name
        for_plus = replace(pose, source=tracked_against)
        frames[write_registration(for_plus, folder / f"{POSE}.xml").name] = for_plus.name
    published = _published_poses(ticks, tracked_against)
    if published:
        write_pose_sequence(published, folder / POSES)
        frames[POSES] = f"ras_from_{tracked_against}"
    if warp is not None:
        write_shape(warp, folder / SHAPE)
        frames[SHAPE] = warp.frame
    write_text(folder / TICKS, ticks_csv(ticks))
    frames[TICKS] = "tracker; tip_mr in mr"
    return frames


def _published_poses(ticks: Ticks, tracked_against: str) -> list[tuple[float, Rigid]]:
    """List the poses through which forces came, motion in breathing included, thinned."""
    t_s, poses = ticks.thinned_poses()
    used = np.isfinite(poses[:, 0, 0])
    return [
        (at_s, Rigid.from_matrix(np.vstack([pose, [0.0, 0.0, 0.0, 1.0]]), "mr", tracked_against))
        for at_s, pose in zip(t_s[used].tolist(), poses[used], strict=True)
    ]


def write_shape(warp: Warp, path: Path) -> None:
    """Write a change of the heart's shape at the pose of its folder; coefficients are float32 in base64.

    Raises:
        OutputError: not writable.
    """
    data = warp.coefficients.astype("<f4").tobytes()
    content = {
        "frame": warp.frame,
        "origin_mm": warp.origin_mm.tolist(),
        "knot_mm": warp.knot_mm,
        "contraction": warp.contraction,
        "coefficients": base64.b64encode(data).decode("ascii"),
    }
    write_sidecar(path, content, "shape")


def read_shape(folder: Path) -> Warp | None:
    """Read what `write_shape` wrote; None if the heart has kept its shape.

    Raises:
        UnreadableFileError: damaged.
    """
    path = folder / SHAPE
    if not path.is_file():
        return None
    content = read_json(path, "a change of shape")
    try:
        data = np.frombuffer(base64.b64decode(content["coefficients"], validate=True), "<f4")
        coefficients = data.reshape(*[COEFFICIENTS] * 3, 4).astype(np.float32)
        origin_mm, knot_mm = np.array(content["origin_mm"]), float(content["knot_mm"])
        return Warp(content["frame"], origin_mm, knot_mm, coefficients, float(content["contraction"]))
    except (KeyError, TypeError, ValueError) as exc:
        raise UnreadableFileError(f"{path} is damaged ({exc}); run again") from exc


def ticks_csv(ticks: Ticks) -> str:
    """Format one row a tick under `COLUMNS`; a cell without value is empty.

    Tip in the tracker's and in the MR's frame (LPS), force in the tracker's.
    """
    columns, form = _columns(ticks), ",".join(one for _, one in COLUMNS) + "\n"
    if len(columns) != len(COLUMNS):
        raise InvalidInputError(f"{len(columns)} columns for {len(COLUMNS)} names")
    text = [_HEADER + "\n"]
    for begin in range(0, len(ticks), _BLOCK):
        rows = zip(*(column[begin : begin + _BLOCK].tolist() for column in columns), strict=True)
        text.append("".join([form % row for row in rows]).replace("nan", "").replace("inf", ""))
    return "".join(text)


_BLOCK = 10_000
"""Rows formatted at a time: Python's numbers take ten times the memory of the arrays."""


def _columns(ticks: Ticks) -> list[AnyArray]:
    pose, phase = ticks.mr_from_tracker, ticks.phase
    tip_mr = np.einsum("nij,nj->ni", pose[:, :, :3], ticks.tip_tracker_mm) + pose[:, :, 3]
    return [
        phase.t_s,
        np.minimum(phase.phi, _BELOW_ONE),
        phase.valid,
        np.minimum(ticks.model_phase, _BELOW_ONE),
        phase.rr_s,
        *ticks.tip_tracker_mm.T,
        *tip_mr.T,
        ticks.distance_mm,
        *ticks.force_n.T,
        _words(ticks.status, lambda code: Status(code).name.lower()),
        _words(ticks.supervisor, lambda code: SupervisorState(code).name.lower()),
        _words(ticks.hazards, lambda bits: "|".join(h.name.lower() for h in Hazard(bits) if h.name)),
        ticks.pose_age_s,
        ticks.pose_bound_mm,
        ticks.margin_mm,
        np.minimum(ticks.breath_phase, _BELOW_ONE),
        ticks.breath_mm,
        _words(ticks.breath_state, breath_word),
    ]


_BELOW_ONE = 0.999999
"""Largest phase written, so that a phase in [0, 1) is not rounded to 1."""


def breath_word(state: int) -> str:
    """Return the word for a state of the clock of breathing; empty if nothing follows the breath."""
    return "" if state == UNFOLLOWED else BreathState(state).name.lower()


def _words(codes: IntArray, word: Callable[[int], str]) -> AnyArray:
    """Convert (n,) codes to words."""
    present, places = np.unique(codes, return_inverse=True)
    return np.array([word(code) for code in present.tolist()], dtype=object)[places]
