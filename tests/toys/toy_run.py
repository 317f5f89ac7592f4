"""A recorded intervention of one second whose every place is known, and a run of it."""

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import (
    CycleTiming,
    Grid,
    ImageMap,
    Landmarks,
    Points,
    PoseStream,
    Preop,
    Rigid,
    Scenario,
    Signal,
    TrackedSequence,
    VolumeSeries,
)
from dvf_ig.replay.export.exported_run import ExportedRun
from dvf_ig.replay.outputs import COLUMNS
from dvf_ig.session import UltrasoundCalibration

FIRST = Rigid.from_rotation_vector([0.4, -0.9, 0.3], [12.5, -40.25, 310.75], "mr", "tracker")
LATER = Rigid.from_rotation_vector([0.41, -0.9, 0.3], [13.5, -40.25, 311.0], "mr", "tracker")
PROBE_FROM_IMAGE = ImageMap(
    Rigid.from_rotation_vector([0.1, 0.2, -0.3], [5.0, 6.0, 7.0], "probe", "image"), np.array([0.3, 0.4])
)
TIP = np.array([[3.0, 1.0, 148.0]])
TOUCHED = np.array([[10.0, 20.0, 30.0], [-55.5, 4.25, -120.0]])
LAG_S = 0.05
T_S = np.arange(10) / 10.0
BRIGHT = (7, 4)
"""Column and row of the one bright pixel."""
MR_GRID = Grid(
    "mr", (5, 6, 7), [10, 20, 30], np.array([1.5, 2.0, 2.5]), Rotation.from_rotvec([0.1, 0, 0.2]).as_matrix()
)


def stream(source: str) -> PoseStream:
    """A hand that moves on a straight line while turning evenly about z: known between samples, too."""
    turns = Rotation.from_rotvec(T_S[:, None] * np.array([0.0, 0.0, 0.5])).as_matrix()
    shifts = np.array([100.0, -50.0, 20.0]) + T_S[:, None] * np.array([10.0, 20.0, 30.0])
    valid = np.ones(10, dtype=bool)
    return PoseStream("tracker", source, T_S, turns, shifts, valid)


def pose_at(t_s: float) -> tuple[np.ndarray, np.ndarray]:
    shift = np.array([100.0, -50.0, 20.0]) + t_s * np.array([10.0, 20.0, 30.0])
    return Rotation.from_rotvec([0.0, 0.0, 0.5 * t_s]).as_matrix(), shift


def recorded() -> Scenario:
    images = np.zeros((10, 8, 12), dtype=np.uint8)
    images[:, BRIGHT[1], BRIGHT[0]] = 50 + np.arange(10)
    shown = np.ones(10, dtype=bool)
    shown[3] = False
    values = np.arange(2 * 5 * 6 * 7, dtype=np.int16).reshape(2, 5, 6, 7)
    names = ("apex", "base")
    return Scenario(
        name="known shift",
        preset="recorded",
        preop=Preop("ball", mr=VolumeSeries(MR_GRID, values, CycleTiming.uniform(2, 0.8))),
        ecg=Signal(np.zeros((100, 1)), 100.0, 0.0, ("II",)),
        ultrasound=TrackedSequence(T_S, images, shown, {"tracker_from_probe": stream("probe")}),
        fan=None,
        probe=PROBE_FROM_IMAGE,
        latency=LAG_S,
        tool=stream("tool"),
        landmarks_mr=Landmarks(names, Points("mr", FIRST.apply_array(TOUCHED))),
        landmarks_tracker=Landmarks(names, Points("tracker", TOUCHED)),
    )


def run_folder() -> ExportedRun:
    calibration = UltrasoundCalibration(PROBE_FROM_IMAGE, LAG_S)
    poses = ((0.3, FIRST), (0.5, LATER))
    return ExportedRun(recorded(), calibration, Points("tool", TIP), poses, ((0.6, 0.72),), 3.2, {})


FORCE = np.array([0.125, -0.25, 0.5])
TIP_TRACKER, TIP_MR = np.array([1.5, -2.5, 3.5]), np.array([12.5, -30.0, 100.0])


def ticks_csv() -> str:
    """Two ticks: in the first nothing is known."""
    first = {"t_s": "0.100000", "status": "no_pose", "supervisor": "fade", "hazards": "no_pose"}
    first |= {f"force_tracker_{axis}_n": "0.000000" for axis in "xyz"}
    second = {"t_s": "0.101000", "status": "ok", "supervisor": "ok", "hazards": "", "phi": "0.250000"}
    second |= {"breath_phase": "0.500000", "breath_mm": "4.0000", "breath_state": "locked"}
    second |= {f"force_tracker_{axis}_n": str(n) for axis, n in zip("xyz", FORCE, strict=True)}
    second |= {f"tip_tracker_{axis}_mm": str(n) for axis, n in zip("xyz", TIP_TRACKER, strict=True)}
    second |= {f"tip_mr_{axis}_mm": str(n) for axis, n in zip("xyz", TIP_MR, strict=True)}
    names = [name for name, _ in COLUMNS]
    rows = [",".join(row.get(name, "") for name in names) for row in (first, second)]
    return "\n".join([",".join(names), *rows, ""])
