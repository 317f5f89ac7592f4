"""Signed distance of one phase as a function of position, through the kernel that the servo loop uses."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import DvfModel, FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.kernels import status as code
from dvf_ig.kernels.spline import spline_batch


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SplineField:
    """Signed distance of one phase of a model.

    Attributes:
        coefficients: (n, cx, cy, cz) of all phases, kept as float32.
        origin_mm: (3,); knot_spacing_mm: pitch (see DvfModel).
        phase: index of the phase.
    """

    coefficients: FloatArray | NDArray[np.float32]
    origin_mm: FloatArray
    knot_spacing_mm: float
    phase: int = 0

    @classmethod
    def of_model(cls, model: DvfModel, phase: int) -> "SplineField":
        return cls(model.coefficients, model.origin_mm, model.knot_spacing_mm, phase)

    def at(self, xyz_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Evaluate (n,) distance in mm and (n, 3) gradient at (n, 3) points.

        Raises:
            InvalidInputError: a point outside the spline's box.
        """
        n = len(xyz_mm)
        distance, gradient, status = np.empty(n), np.empty((n, 3)), np.empty(n, dtype=np.int64)
        spline_batch(
            np.asarray(self.coefficients, dtype=np.float32),
            np.array(self.origin_mm),
            self.knot_spacing_mm,
            self.phase,
            np.ascontiguousarray(xyz_mm),
            distance,
            gradient,
            status,
        )
        outside = int(np.count_nonzero(status != code.OK))
        if outside:
            raise InvalidInputError(
                f"phase {self.phase}: {outside} of {n} points lie outside the model's box; "
                "build it with a wider margin"
            )
        return distance, gradient

    def off_surface_mm(self, xyz_mm: FloatArray) -> FloatArray:
        """Compute the (n,) distance |d|/|∇d| from points to the zero level nearby, to first order."""
        distance, gradient = self.at(xyz_mm)
        return np.asarray(np.abs(distance) / np.maximum(np.linalg.norm(gradient, axis=1), 1e-9))
