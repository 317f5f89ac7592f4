"""What a replay leaves for other programs: pose (ITK, PLUS), poses over time (3D Slicer), and every tick."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, OutputError, Rigid
from dvf_ig.guidance import Hazard, Status, SupervisorState
from dvf_ig.io import refuse_foreign, write_pose_sequence, write_registration, write_text, write_transforms

from .ticks import Ticks

POSE, POSES, TICKS = "mr_from_tracker", "poses.seq.mha", "ticks.csv"
NAMES = (f"{POSE}.tfm", f"{POSE}.h5", f"{POSE}.json", f"{POSE}.xml", POSES, TICKS)
"""Every file that may be written."""

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
)
"""Of the ticks, each with its format: 1 µs, 0.1 µm, 1 µN."""
_HEADER = ",".join(name for name, _ in COLUMNS)


def require_own_outputs(folder: Path) -> None:
    """Refuse a folder in which a user's own file has the name of an output.

    Raises:
        OutputError: naming the file.
    """
    refuse_foreign(*(folder / name for name in NAMES if name != TICKS))
    table = folder / TICKS
    if table.is_file():
        with table.open("rb") as stream:
            ours = stream.read(len(_HEADER)) == _HEADER.encode()
        if not ours:
            raise OutputError(
                f"cannot write {table}: a file of that name exists and was not written by this command; move "
                "it, or choose another folder"
            )


def write_outputs(poses: Sequence[tuple[float, Rigid]], ticks: Ticks, folder: Path) -> dict[str, str]:
    """Write the last pose in use and the poses over time, where there was one, and the ticks.

    Args:
        poses: (time from which it was in use, mr_from_tracker) in order of time.
        ticks: of the replay.
        folder: holds nothing of a user's (see `require_own_outputs`).
    Returns:
        what was written: name of the file, and the frame of what is in it.
    Raises:
        OutputError: not writable.
    """
    frames = {}
    if poses:
        pose = poses[-1][1]
        for path in write_transforms(pose, folder / NAMES[0]):
            frames[path.name] = pose.name
        frames[f"{POSE}.json"] = pose.name
        frames[write_registration(pose, folder / f"{POSE}.xml").name] = pose.name
        write_pose_sequence(poses, folder / POSES)
        frames[POSES] = "ras_from_tracker"
    write_text(folder / TICKS, ticks_csv(ticks))
    frames[TICKS] = "tracker; tip_mr in mr"
    return frames


def ticks_csv(ticks: Ticks) -> str:
    """One row a tick under `COLUMNS`; a cell is empty where there is no value.

    Tip in the tracker's and in the MR's frame (LPS), force in the tracker's.
    """
    pose = ticks.mr_from_tracker
    tip_mr = np.einsum("nij,nj->ni", pose[:, :, :3], ticks.tip_tracker_mm) + pose[:, :, 3]
    phase = ticks.phase
    columns = [
        phase.t_s.tolist(),
        _below_one(phase.phi),
        phase.valid.tolist(),
        _below_one(ticks.model_phase),
        phase.rr_s.tolist(),
        *ticks.tip_tracker_mm.T.tolist(),
        *tip_mr.T.tolist(),
        ticks.distance_mm.tolist(),
        *ticks.force_n.T.tolist(),
        [_STATUS[code] for code in ticks.status.tolist()],
        [_SUPERVISOR[code] for code in ticks.supervisor.tolist()],
        _hazards(ticks.hazards.tolist()),
        ticks.pose_age_s.tolist(),
    ]
    if len(columns) != len(COLUMNS):
        raise InvalidInputError(f"{len(columns)} columns for {len(COLUMNS)} names")
    form = ",".join(one for _, one in COLUMNS)
    rows = "\n".join([form % row for row in zip(*columns, strict=True)])
    return f"{_HEADER}\n{rows}\n".replace("nan", "").replace("inf", "")


_STATUS = {int(one): one.name.lower() for one in Status}
_SUPERVISOR = {int(one): one.name.lower() for one in SupervisorState}


def _below_one(phase: FloatArray) -> list[float]:
    """So that a phase in [0, 1) is not rounded to 1."""
    below: list[float] = np.minimum(phase, 0.999999).tolist()
    return below


def _hazards(bits: list[int]) -> list[str]:
    names = {one: "|".join(h.name.lower() for h in Hazard(one) if h.name) for one in set(bits)}
    return [names[one] for one in bits]
