"""Stubs of atria for hearts of which only the ventricles are known."""

from dataclasses import dataclass

import numpy as np

from data_synth.heart.reference import Layers
from data_synth.heart.tissue import Tissue
from dvf_ig.core import FloatArray, read_only_arrays

ATRIAL_WALL_MM = 2.5


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class AtrialStub:
    """Stub of atria: blood beyond the valve plane, within the epicardium.

    Attributes:
        valves_mm: (3,) a point of the plane at which they begin.
        along: (3,) unit vector from the ventricles to the atria.
        left_mm, right_mm: (3,) middle of each ventricle; the septum is half-way between.
    """

    valves_mm: FloatArray
    along: FloatArray
    left_mm: FloatArray
    right_mm: FloatArray

    def layers(self, xyz_mm: FloatArray, organ: FloatArray) -> Layers:
        """Return wall, then the blood of each side, to be painted over the base tissue."""
        above = (xyz_mm - self.valves_mm) @ self.along
        across = self.left_mm - self.right_mm
        across = across - (across @ self.along) * self.along
        side = (xyz_mm - 0.5 * (self.left_mm + self.right_mm)) @ (across / np.linalg.norm(across))
        room = np.minimum(organ - ATRIAL_WALL_MM, above)
        return [
            (Tissue.ATRIAL_WALL, above + ATRIAL_WALL_MM),
            (Tissue.LA_BLOOD, np.minimum(room, side - 1.5)),
            (Tissue.RA_BLOOD, np.minimum(room, -side - 1.5)),
        ]
