"""Free-form deformation: a displacement that is a tensor-product cubic B-spline on a coarse lattice.

On the voxels everything is separable: value and adjoint are three banded products, one along each axis.
Rows are summed in one order, so the result does not depend on the number of threads.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_array, diags_array, eye_array, kron

from dvf_ig.core import BoolArray, FloatArray, Grid, IntArray, read_only_arrays
from dvf_ig.preop.banded import BandedRows

Axes = tuple[BandedRows, BandedRows, BandedRows]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Control points over an image, along the axes of its grid.

    Attributes:
        grid: voxels on which the displacement is evaluated.
        cells: knot cells along each axis.
        pitch_mm: (3,) knot pitch; divides the image's extent evenly.
        basis: per axis, (voxels, cells + 3) values of the cubic B-splines at the voxel centres.
    """

    grid: Grid
    cells: tuple[int, int, int]
    pitch_mm: FloatArray
    basis: Axes

    @classmethod
    def over(cls, grid: Grid, pitch_mm: float | FloatArray) -> "Lattice":
        """Place knots about every `pitch_mm` (one for all axes, or (3,)), never closer than the voxels."""
        extent_mm = np.maximum(np.array(grid.shape) - 1, 1) * grid.spacing_mm
        count = np.maximum(np.rint(extent_mm / np.maximum(pitch_mm, grid.spacing_mm)), 1).astype(np.int64)
        pitch = extent_mm / count
        x, y, z = (
            axis_basis(np.arange(n) * step / knot, int(cells))
            for n, step, knot, cells in zip(grid.shape, grid.spacing_mm, pitch, count, strict=True)
        )
        return cls(grid, (int(count[0]), int(count[1]), int(count[2])), pitch, (x, y, z))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Control points along each axis."""
        return self.cells[0] + 3, self.cells[1] + 3, self.cells[2] + 3

    def thinned(self, step: tuple[int, int, int]) -> "Lattice":
        """Return the same control points evaluated on every step-th voxel along each axis."""
        x, y, z = (
            BandedRows(b.first[::s], b.weights[::s], b.columns) for b, s in zip(self.basis, step, strict=True)
        )
        shape = (len(x.first), len(y.first), len(z.first))
        spacing = self.grid.spacing_mm * step
        grid = Grid(self.grid.frame, shape, self.grid.origin_mm, spacing, self.grid.direction)
        return Lattice(grid, self.cells, self.pitch_mm, (x, y, z))

    def on_voxels(self, coefficients: FloatArray) -> FloatArray:
        """Evaluate (cx, cy, cz, k) coefficients to (nx, ny, nz, k) values at the voxel centres."""
        for axis in (2, 1, 0):
            coefficients = self.basis[axis].along(axis, coefficients)
        return coefficients

    def adjoint(self, values: FloatArray) -> FloatArray:
        """Apply Bᵀ, the transpose of `on_voxels`, to (nx, ny, nz, k) values."""
        for axis, basis in enumerate(self.basis):
            values = basis.transposed_along(axis, values)
        return values

    def adjoint_of_squares(self, values: FloatArray) -> FloatArray:
        """Compute the diagonal of BᵀWB, (cx, cy, cz, k), from (nx, ny, nz, k) weights."""
        for axis, basis in enumerate(self.basis):
            squares = BandedRows(basis.first, basis.weights**2, basis.columns)
            values = squares.transposed_along(axis, values)
        return values


@dataclass(frozen=True, slots=True, eq=False)
class Bending:
    """Bending energy cᵀHc = ∫ Σ_ab (∂²u/∂a∂b)² dV of a displacement, from differences of coefficients.

    Attributes:
        matrix: H of one component, control points in the order of the lattice.
    Source: Rueckert 1999, eq. 5, with the differences of Eilers and Marx 1996 in place of the integrals.
    """

    matrix: csr_array

    @classmethod
    def of(cls, lattice: Lattice, least_pitch_mm: FloatArray | None = None) -> "Bending":
        """Build the energy on a lattice.

        Args:
            least_pitch_mm: (3,) pitch assumed for closer knots: if the distance between slices is unknown,
                each is not tied to the next as if they touched.
        """
        one, slope, curve = [], [], []
        pitches = lattice.pitch_mm if least_pitch_mm is None else np.maximum(lattice.pitch_mm, least_pitch_mm)
        for count, pitch in zip(lattice.shape, pitches.tolist(), strict=True):
            first = diags_array([-1.0, 1.0], offsets=[0, 1], shape=(count - 1, count)) / pitch
            second = diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(count - 2, count)) / pitch**2
            one.append(csr_array(eye_array(count)))
            slope.append(csr_array(first.T @ first))
            curve.append(csr_array(second.T @ second))
        terms = (
            _product(curve[0], one[1], one[2]),
            _product(one[0], curve[1], one[2]),
            _product(one[0], one[1], curve[2]),
            2.0 * _product(slope[0], slope[1], one[2]),
            2.0 * _product(slope[0], one[1], slope[2]),
            2.0 * _product(one[0], slope[1], slope[2]),
        )
        return cls(csr_array(float(np.prod(lattice.pitch_mm)) * sum(terms[1:], terms[0])))

    def half_gradient(self, coefficients: FloatArray) -> FloatArray:
        """Compute Hc, same shape as the (cx, cy, cz, k) coefficients."""
        return np.asarray(self.matrix @ coefficients.reshape(self.matrix.shape[0], -1)).reshape(
            coefficients.shape
        )

    def diagonal(self, lattice: Lattice) -> FloatArray:
        """Return (cx, cy, cz, 1) the diagonal of H."""
        return np.asarray(self.matrix.diagonal()).reshape(*lattice.shape, 1)


def _product(x: csr_array, y: csr_array, z: csr_array) -> csr_array:
    """x ⊗ y ⊗ z."""
    return csr_array(kron(kron(x, y), z))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FreeForm:
    """Deformation x ↦ x + u(x), u a spline on a lattice.

    Attributes:
        lattice: the control points.
        coefficients: (cx, cy, cz, 3) mm along the axes of the lattice's grid.
    """

    lattice: Lattice
    coefficients: FloatArray

    @classmethod
    def identity(cls, lattice: Lattice) -> "FreeForm":
        return cls(lattice, np.zeros((*lattice.shape, 3)))

    @property
    def grid(self) -> Grid:
        return self.lattice.grid

    def on_voxels(self) -> FloatArray:
        """Return (nx, ny, nz, 3) displacement at the voxel centres, mm along the grid's axes."""
        return self.lattice.on_voxels(self.coefficients)

    def move(self, xyz_mm: FloatArray) -> FloatArray:
        """Displace (n, 3) points; outside the image the displacement at its border is used."""
        grid, lattice = self.lattice.grid, self.lattice
        knots = grid.to_index(xyz_mm) * grid.spacing_mm / lattice.pitch_mm
        knots = np.clip(knots, 0.0, np.array(lattice.cells, dtype=np.float64))
        # of every B-spline, the control point of index k lies at knot k - 1
        at = (knots + 1.0).T
        moved = np.zeros_like(knots)
        for axis in np.flatnonzero(self.coefficients.any(axis=(0, 1, 2))):
            points = self.coefficients[..., axis]
            moved[:, axis] = ndimage.map_coordinates(points, at, order=3, mode="mirror", prefilter=False)
        return np.asarray(xyz_mm + moved @ grid.direction.T)


def volume_ratio(moved_mm: FloatArray, spacing_mm: FloatArray, where: BoolArray) -> FloatArray:
    """Compute (n,) Jacobian determinants of ∂x/∂X at chosen voxels, from central differences.

    Args:
        moved_mm: (nx, ny, nz, 3) displacement along the grid's axes.
        where: (nx, ny, nz) the n voxels.
    """
    gradient = np.zeros((int(np.count_nonzero(where)), 3, 3))
    for axis in range(3):
        if moved_mm.shape[axis] > 1:
            gradient[..., axis] = np.gradient(moved_mm, spacing_mm[axis], axis=axis)[where]
    return np.asarray(np.linalg.det(gradient + np.eye(3)))


def axis_basis(knots: FloatArray, cells: int) -> BandedRows:
    """Evaluate (n, cells + 3) cubic B-splines at positions (n,) in knot units, 0 … cells."""
    return BandedRows(*cell_and_weights(knots, cells), cells + 3)


def cell_and_weights(knots: FloatArray, cells: int) -> tuple[IntArray, FloatArray]:
    """Find the (n,) knot cell of each position, and the (n, 4) values of the B-splines that reach it."""
    cell = np.clip(np.floor(knots).astype(np.int64), 0, cells - 1)
    t = knots - cell
    weights = np.stack(
        [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1
    )
    return cell, weights / 6.0
