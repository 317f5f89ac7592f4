"""Electromagnetic tracker with distortion, drift and noise."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.seeds import child_rng
from data_synth.signals.smooth_noise import smooth_noise
from data_synth.signals.tracker import PosePath, TrackerSpec
from dvf_ig.core import FloatArray

from .drawn import Drawn
from .random_fields import GridField, random_displacement_field

_TABLE_MM = 25.0
_MARGIN_MM = 80.0


@dataclass(frozen=True, slots=True, eq=False)
class DistortedField:
    """Tracker's readings of sensors at true poses.

    Attributes:
        shift: displacement of a sensor's reading, frame "tracker", without a rigid part over the workspace.
        turn: the same of its orientation, rotation vector in rad (as a displacement field in mm / mm).
        drawn: values drawn; the slow drift is the same for every sensor.
    """

    shift: GridField
    turn: GridField
    drawn: Drawn

    def read(self, path: PosePath) -> PosePath:
        """Compute tracker_from_sensor as read, before noise."""
        drift = smooth_noise(3, 0.004, 0.03, child_rng(self.drawn.seed, "second world drift"))
        size = self.drawn["tracker.drift_mm"] / np.sqrt(3.0)

        def reported(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
            rotations, positions = path(t_s)
            bent = Rotation.from_rotvec(self.turn.at(positions)).as_matrix() @ rotations
            return bent, positions + self.shift.at(positions) + size * (drift(t_s) - drift(np.zeros(1)))

        return reported


def distorted_field(workspace_mm: FloatArray, drawn: Drawn) -> DistortedField:
    """Draw the field over a (2, 3) box of the frame "tracker" in which sensors and heart stay."""
    wide = workspace_mm + np.array([[-_MARGIN_MM], [_MARGIN_MM]])
    length = drawn["tracker.bias_length_mm"]

    def field(size: float, stream: str) -> GridField:
        rng = child_rng(drawn.seed, f"second world {stream}")
        return random_displacement_field(wide, workspace_mm, size, length, _TABLE_MM, rng)

    return DistortedField(
        field(drawn["tracker.bias_mm"], "tracker bias"),
        field(float(np.deg2rad(drawn["tracker.bias_deg"])), "tracker turn"),
        drawn,
    )


def probe_sensor(drawn: Drawn, rate_hz: float) -> TrackerSpec:
    """Draw the noise of the sensor on the probe."""
    return TrackerSpec(
        rate_hz=rate_hz,
        position_mm=drawn["tracker.position_mm"],
        rotation_deg=drawn["tracker.rotation_deg"],
        dropouts_per_min=drawn["tracker.dropouts_per_min"],
    )


def tool_sensor(drawn: Drawn) -> TrackerSpec:
    """Draw the noise of the sensor in the tool, which the tracker's software smooths more."""
    return TrackerSpec(
        rate_hz=100.0,
        position_mm=0.5 * drawn["tracker.position_mm"],
        rotation_deg=0.5 * drawn["tracker.rotation_deg"],
        dropouts_per_min=drawn["tracker.dropouts_per_min"],
    )
