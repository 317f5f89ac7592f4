"""Tensor-product spline network of any degrees and knot pitches (Ren 2008, eq. 1).

d(x, y, z) = Σ p_ijk B_i(x) C_j(y) D_k(z) with uniform B-splines of degree 1 to 5 and a pitch of its own along
each axis. The servo loop evaluates cubic splines with the same pitch along each axis
(`dvf_ig.kernels.spline`); that is what a DvfModel holds, and what `dvf_ig.preop.spline.fit` fits.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_array

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.core.arrays import check_shape

DEGREES = range(1, 6)


@dataclass(frozen=True, slots=True)
class SplineAxis:
    """Uniform B-splines along one axis, defined on `cells` whole cells.

    Attributes:
        degree: 1 (linear) to 5.
        origin_mm: start of the first cell.
        spacing_mm: knot pitch.
        cells: number of cells; there are cells + degree basis functions.
    """

    degree: int
    origin_mm: float
    spacing_mm: float
    cells: int

    def __post_init__(self) -> None:
        if self.degree not in DEGREES:
            raise InvalidInputError(f"spline degree is {self.degree}; choose {DEGREES[0]} to {DEGREES[-1]}")
        if not self.spacing_mm > 0.0 or not np.isfinite([self.spacing_mm, self.origin_mm]).all():
            raise InvalidInputError(
                f"knots start at {self.origin_mm:g} mm every {self.spacing_mm:g} mm; needed a finite start "
                "and a positive pitch"
            )
        if self.cells < 1:
            raise InvalidInputError(f"{self.cells} knot cells along an axis; needed at least 1")

    @property
    def functions(self) -> int:
        return self.cells + self.degree

    @property
    def upper_mm(self) -> float:
        return self.origin_mm + self.cells * self.spacing_mm

    def values(self, x_mm: FloatArray) -> csr_array:
        """(n, functions) value of every basis function at (n,) positions.

        Raises:
            InvalidInputError: a position outside the cells.
        """
        return self._design(x_mm, self.degree)

    def derivatives(self, x_mm: FloatArray) -> csr_array:
        """(n, functions) derivative of every basis function, 1/mm: (B_(i−1) − B_i)/pitch, a degree lower."""
        lower = self._design(x_mm, self.degree - 1)
        n = lower.shape[0]
        values = np.pad(lower.data.reshape(n, self.degree), [(0, 0), (1, 1)])
        columns = lower.indices.reshape(n, self.degree)[:, :1] + np.arange(self.degree + 1)
        rows = np.repeat(np.arange(n), self.degree + 1)
        derivatives = (values[:, :-1] - values[:, 1:]) / self.spacing_mm
        return csr_array((derivatives.ravel(), (rows, columns.ravel())), shape=(n, self.functions))

    def _design(self, x_mm: FloatArray, degree: int) -> csr_array:
        u = self._knot_coordinates(x_mm)
        knots = np.arange(-degree, self.cells + degree + 1, dtype=np.float64)
        return csr_array(BSpline.design_matrix(u, knots, degree))

    def _knot_coordinates(self, x_mm: FloatArray) -> FloatArray:
        """(n,) positions in knots from the origin; rounding errors at either end are tolerated."""
        u = (np.asarray(x_mm, dtype=np.float64) - self.origin_mm) / self.spacing_mm
        tolerance = 1e-9 * self.cells
        if not ((u >= -tolerance) & (u <= self.cells + tolerance)).all():
            raise InvalidInputError(
                f"positions from {np.min(x_mm):g} to {np.max(x_mm):g} mm; the spline is defined from "
                f"{self.origin_mm:g} to {self.upper_mm:g} mm"
            )
        return np.clip(u, 0.0, self.cells)


@dataclass(frozen=True, slots=True)
class SplineNetwork:
    """Three axes; coefficients are arrays of `shape`."""

    x: SplineAxis
    y: SplineAxis
    z: SplineAxis

    @property
    def axes(self) -> tuple[SplineAxis, SplineAxis, SplineAxis]:
        return self.x, self.y, self.z

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.x.functions, self.y.functions, self.z.functions

    def design(self, xyz_mm: FloatArray) -> csr_array:
        """(n, functions) value of every product of basis functions at (n, 3) points, in `ravel` order."""
        check_shape(np.asarray(xyz_mm), "points", (None, 3))
        return self._products(*(axis.values(xyz_mm[:, a]) for a, axis in enumerate(self.axes)))

    def value_and_gradient(
        self, coefficients: FloatArray, xyz_mm: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(n,) values and (n, 3) gradients per mm at (n, 3) points.

        Raises:
            InvalidInputError: coefficients of another shape, or a point outside.
        """
        check_shape(coefficients, "spline coefficients", self.shape)
        flat = coefficients.ravel()
        values = [axis.values(xyz_mm[:, a]) for a, axis in enumerate(self.axes)]
        gradient = np.empty((len(xyz_mm), 3))
        for a, axis in enumerate(self.axes):
            along = [*values[:a], axis.derivatives(xyz_mm[:, a]), *values[a + 1 :]]
            gradient[:, a] = self._products(*along) @ flat
        return np.asarray(self._products(*values) @ flat), gradient

    def _products(self, x: csr_array, y: csr_array, z: csr_array) -> csr_array:
        """Row-wise Kronecker product of three sparse matrices with a fixed number of entries a row."""
        n = x.shape[0]
        columns, values = np.zeros((n, 1), dtype=np.int64), np.ones((n, 1))
        for matrix, axis in zip((x, y, z), self.axes, strict=True):
            index = matrix.indices.reshape(n, -1).astype(np.int64)
            columns = (columns[:, :, None] * axis.functions + index[:, None]).reshape(n, -1)
            values = (values[:, :, None] * matrix.data.reshape(n, -1)[:, None]).reshape(n, -1)
        rows = np.repeat(np.arange(n), columns.shape[1])
        return csr_array((values.ravel(), (rows, columns.ravel())), shape=(n, int(np.prod(self.shape))))
