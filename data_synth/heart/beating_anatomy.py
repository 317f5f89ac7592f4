"""Protocol of every synthetic heart."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, IntArray, Landmarks

from .motion import PullBack
from .reference import ReferenceMap

REFERENCE_SPACING_MM = 1.25
MARGIN_MM = 32.0
"""Width around the heart box in which tissue is known."""


class BeatingAnatomy(Protocol):
    """Beating heart: the anatomy during the intervention.

    Frame "mr" throughout. `model_phase`: fraction of the pre-operative cycle, cyclic; 0 is end-diastole.

    Attributes:
        rr_s: RR interval of the pre-operative acquisition.
        es_fraction: end-systole as a fraction of that cycle.
        box_mm: (2, 3) heart box.
        surface_triangles: (m, 3) of the epicardial surface, outward, watertight.
        reference: tissue fields at end-diastole.
        inverse_motion: intra-operative position to reference position (motion and mismatch).
    """

    @property
    def rr_s(self) -> float: ...
    @property
    def es_fraction(self) -> float: ...
    @property
    def box_mm(self) -> FloatArray: ...
    @property
    def surface_triangles(self) -> IntArray: ...
    @property
    def reference(self) -> ReferenceMap: ...
    @property
    def inverse_motion(self) -> PullBack: ...

    def tissue(self, xyz_mm: FloatArray, model_phase: float) -> NDArray[np.uint8]:
        """Return (n,) tissue codes of the intra-operative anatomy at (n, 3) points."""

    def material(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        """Return (n, 3) reference positions X = χ⁻¹(x), with which scatterers move."""

    def surface_vertices(self, model_phase: float) -> FloatArray:
        """Return the (v, 3) true epicardial surface of the intra-operative anatomy."""

    def targets(self) -> Landmarks:
        """Return named points and 27 grid points of the heart box at which registration errors are stated."""

    def landmarks(self) -> Landmarks:
        """Return points on the pre-operative end-diastolic surface that a stylus could touch."""
