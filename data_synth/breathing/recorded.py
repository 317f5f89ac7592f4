"""Recorded traces of breathing: a ventilator's channels, and a tracked marker on the chest."""

from typing import Any

import numpy as np

from data_synth.operator.pose_path import composed, inverted
from data_synth.signals.tracker import PosePath, TrackerSpec, sampling_times, tracked
from dvf_ig.core import FloatArray, PoseStream, Respiration, Signal

from .breaths import GRID_S, Breaths, lagged
from .motion import Breathing

VENTILATOR_HZ = 50.0
VENTILATOR_LATE_S = 0.05
CHANNELS = ("pressure_cmh2o", "flow_l_per_s", "volume_ml")
TIDAL_ML = 450.0
PEEP, ELASTANCE, RESISTANCE = 5.0, 10.0, 1.5
"""cmH2O; cmH2O and cmH2O·s for one ordinary breath, of the trachea behind the tube."""
NOISE = (0.3, 0.01, 5.0)
"""SD of each channel."""
CHEST_TRACKER = TrackerSpec(rate_hz=20.0, position_mm=0.25, rotation_deg=0.3, dropouts_per_min=1.0)
CHEST_RISE_MM = 7.0
CHEST_LAG_S = 0.08


def recorded_breathing(
    breathing: Breathing, mr_from_tracker: PosePath, seconds: float, rng: np.random.Generator
) -> dict[str, Any]:
    """Record the breath as fields of a scenario: the chest, and a ventilator, which is then in use."""
    chest = _chest(breathing.breaths, mr_from_tracker, breathing.center_mm, seconds, rng)
    if breathing.spec.kind == "spontaneous":
        seen = chest.valid
        used = Respiration(chest.t_s[seen], chest.translations_mm[seen], chest.source)
        return {"chest": chest, "respiration": used}
    ventilator = _ventilator(breathing.breaths, seconds, rng)
    used = Respiration(ventilator.t_s, ventilator.samples[:, :1], ventilator.leads[0])
    return {"chest": chest, "ventilator": ventilator, "respiration": used}


def _ventilator(breaths: Breaths, seconds: float, rng: np.random.Generator) -> Signal:
    """Record pressure, flow and volume, late by VENTILATOR_LATE_S; without the patient they read 0."""
    volume, on = breaths.volume, breaths.connected
    flow = np.gradient(volume, GRID_S)
    pressure = PEEP + ELASTANCE * volume + RESISTANCE * flow
    channels = np.stack([on * pressure, on * flow * TIDAL_ML / 1000.0, on * volume * TIDAL_ML], axis=1)
    smooth = np.stack([lagged(column, 0.02) for column in channels.T], axis=1)
    t_s = np.arange(round(seconds * VENTILATOR_HZ)) / VENTILATOR_HZ
    late = np.stack([np.interp(t_s - VENTILATOR_LATE_S, breaths.t_s, column) for column in smooth.T], axis=1)
    noisy = late + np.array(NOISE) * rng.standard_normal(late.shape)
    return Signal(np.round(noisy, 5), VENTILATOR_HZ, 0.0, CHANNELS, "")


def _chest(
    breaths: Breaths,
    mr_from_tracker: PosePath,
    heart_mm: FloatArray,
    seconds: float,
    rng: np.random.Generator,
) -> PoseStream:
    """Track a marker that lies in front of the heart and rises with the chest, tracker_from_chest."""
    risen = CHEST_RISE_MM * lagged(breaths.volume, CHEST_LAG_S)
    ahead = np.array([0.05, -1.0, 0.12])
    skin = heart_mm + 90.0 * ahead / np.linalg.norm(ahead)
    turn = np.eye(3)

    def mr_from_chest(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        rise = np.interp(t_s, breaths.t_s, risen)[:, None] * ahead
        return np.repeat(turn[None], len(t_s), axis=0), skin + rise

    true_s, stamp_s = sampling_times(CHEST_TRACKER, 0.0, seconds, rng)
    path = composed(inverted(mr_from_tracker), mr_from_chest)
    return tracked(path, "tracker", "chest", true_s, stamp_s, CHEST_TRACKER, rng)
