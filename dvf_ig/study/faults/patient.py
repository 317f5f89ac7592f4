"""The patient of the study: a beating wall, a pose that is known, and a session's setup on them."""

from functools import lru_cache

import numpy as np

from dvf_ig.core import FloatArray, Grid, ImageMap, Points, Rigid
from dvf_ig.registration import ModelChannels, PoseChart
from dvf_ig.session import CalibrationsInUse, EcgSource, Heart, SessionSetup
from dvf_ig.study.passivity.wall import wall_model

AMPLITUDE_MM = 5.0
MODEL_RR_S = 0.8
CENTER = np.zeros(3)
HOME = Rigid.from_rotation_vector([0.3, -0.5, 0.8], [60.0, -30.0, 12.0], "mr", "tracker")
"""mr_from_tracker of a patient at rest."""
TIP = Points("tool", np.array([[10.0, 0.0, 150.0]]))
LAG_S = -0.06
ECG_HZ = 250.0


@lru_cache(maxsize=1)
def wall_heart() -> Heart:
    """The wall, with channels that say when in the cycle it is known, and nothing else."""
    model = wall_model(AMPLITUDE_MM, rr_s=MODEL_RR_S)
    grid = Grid.axis_aligned("mr", (2, 2, 2), np.zeros(3), 1.0)
    channels = ModelChannels(grid, np.zeros((20, 2, 2, 2, 2), dtype=np.float32), np.arange(20) / 20)
    return Heart(model, channels, CENTER, None)


def wall_setup() -> SessionSetup:
    """A session that starts 3 mm from where the patient is."""
    probe_from_image = ImageMap(Rigid.identity("probe", "image"), np.array([4.0, 4.0]))
    calibrations = CalibrationsInUse(probe_from_image, LAG_S, TIP)
    start = pose_at(np.array([0.0, 0.0, 0.0, 3.0, 0.0, 0.0]))
    return SessionSetup(wall_heart(), calibrations, EcgSource(ECG_HZ), start=start)


def pose_at(coordinates: FloatArray) -> Rigid:
    """mr_from_tracker at (6,) coordinates about HOME, mm (`PoseChart`)."""
    return PoseChart(HOME, CENTER).pose(coordinates)
