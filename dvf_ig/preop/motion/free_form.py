"""Free-form deformation: a displacement that is a tensor-product cubic B-spline on a coarse lattice.

On the voxels everything is separable: value and adjoint are three sparse products, one along each axis.
Sparse rows are summed in one order, so the result does not depend on the number of threads.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from dvf_ig.core import BoolArray, FloatArray, Grid, IntArray, read_only_arrays

Axes = tuple[csr_array, csr_array, csr_array]


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
    def over(cls, grid: Grid, pitch_mm: float) -> "Lattice":
        """Knots about every `pitch_mm`, but never closer than the voxels along any axis."""
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
        """The same control points, evaluated on every step-th voxel along each axis."""
        x, y, z = (b[::s] for b, s in zip(self.basis, step, strict=True))
        shape = (x.shape[0], y.shape[0], z.shape[0])
        spacing = self.grid.spacing_mm * step
        grid = Grid(self.grid.frame, shape, self.grid.origin_mm, spacing, self.grid.direction)
        return Lattice(grid, self.cells, self.pitch_mm, (x, y, z))

    def on_voxels(self, coefficients: FloatArray) -> FloatArray:
        """(cx, cy, cz, k) coefficients to (nx, ny, nz, k) values at the voxel centres."""
        return _along_axes(self.basis, coefficients)

    def adjoint(self, values: FloatArray) -> FloatArray:
        """(nx, ny, nz, k) to (cx, cy, cz, k): Bᵀ, the transpose of `on_voxels`."""
        x, y, z = (b.T.tocsr() for b in self.basis)
        return _along_axes((x, y, z), values)

    def adjoint_of_squares(self, values: FloatArray) -> FloatArray:
        """(nx, ny, nz, k) weights w to (cx, cy, cz, k): the diagonal of BᵀWB."""
        x, y, z = (b.multiply(b).T.tocsr() for b in self.basis)
        return _along_axes((x, y, z), values)


@dataclass(frozen=True, slots=True, eq=False)
class Bending:
    """Bending energy ∫ Σ_ab (∂²u/∂a∂b)² dV of a lattice's displacement, from differences of coefficients.

    Source: Rueckert 1999, eq. 5, with the differences of Eilers and Marx 1996 in place of the integrals.
    """

    first: Axes
    second: Axes
    cell_mm3: float

    @classmethod
    def of(cls, lattice: Lattice) -> "Bending":
        first, second = [], []
        for count, pitch in zip(lattice.shape, lattice.pitch_mm.tolist(), strict=True):
            slope = diags_array([-1.0, 1.0], offsets=[0, 1], shape=(count - 1, count)) / pitch
            curve = diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(count - 2, count)) / pitch**2
            first.append(csr_array(slope.T @ slope))
            second.append(csr_array(curve.T @ curve))
        cell_mm3 = float(np.prod(lattice.pitch_mm))
        return cls((first[0], first[1], first[2]), (second[0], second[1], second[2]), cell_mm3)

    def half_gradient(self, coefficients: FloatArray) -> FloatArray:
        """Hc of the energy cᵀHc, same shape as the (cx, cy, cz, k) coefficients."""
        total = np.zeros_like(coefficients)
        for axis, matrix in enumerate(self.second):
            total += _along_axis(matrix, coefficients, axis)
        for axis, other in ((0, 1), (0, 2), (1, 2)):
            slope = _along_axis(self.first[axis], coefficients, axis)
            total += 2.0 * _along_axis(self.first[other], slope, other)
        return self.cell_mm3 * total

    def diagonal(self) -> FloatArray:
        """(cx, cy, cz, 1) the diagonal of H."""
        slope, curve = ([m.diagonal() for m in axes] for axes in (self.first, self.second))
        one = [np.ones(len(d)) for d in slope]
        terms = (
            _outer(curve[0], one[1], one[2]),
            _outer(one[0], curve[1], one[2]),
            _outer(one[0], one[1], curve[2]),
            2.0 * _outer(slope[0], slope[1], one[2]),
            2.0 * _outer(slope[0], one[1], slope[2]),
            2.0 * _outer(one[0], slope[1], slope[2]),
        )
        return np.asarray(self.cell_mm3 * np.sum(terms, axis=0)[..., None])


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FreeForm:
    """x ↦ x + u(x), u from a lattice.

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
        """(nx, ny, nz, 3) displacement at the voxel centres, mm along the grid's axes."""
        return self.lattice.on_voxels(self.coefficients)

    def move(self, xyz_mm: FloatArray) -> FloatArray:
        """(n, 3) displaced points; outside the image the displacement at its border is used."""
        grid, lattice = self.lattice.grid, self.lattice
        knots = grid.to_index(xyz_mm) * grid.spacing_mm / lattice.pitch_mm
        knots = np.clip(knots, 0.0, np.array(lattice.cells, dtype=np.float64))
        (x, wx), (y, wy), (z, wz) = (cell_and_weights(knots[:, a], lattice.cells[a]) for a in range(3))
        near = np.arange(4)
        at = (x[:, None, None, None] + near[:, None, None], y[:, None, None, None] + near[:, None])
        support = self.coefficients[(*at, z[:, None, None, None] + near)]
        along_z = np.einsum("nk,nijkd->nijd", wz, support)
        moved = np.einsum("ni,nid->nd", wx, np.einsum("nj,nijd->nid", wy, along_z))
        return np.asarray(xyz_mm + moved @ grid.direction.T)


def volume_ratio(moved_mm: FloatArray, spacing_mm: FloatArray, where: BoolArray) -> FloatArray:
    """(n,) Jacobian determinant of ∂x/∂X at chosen voxels, from central differences.

    Args:
        moved_mm: (nx, ny, nz, 3) displacement along the grid's axes.
        where: (nx, ny, nz) the n voxels.
    """
    gradient = np.zeros((int(np.count_nonzero(where)), 3, 3))
    for axis in range(3):
        if moved_mm.shape[axis] > 1:
            gradient[..., axis] = np.gradient(moved_mm, spacing_mm[axis], axis=axis)[where]
    return np.asarray(np.linalg.det(gradient + np.eye(3)))


def axis_basis(knots: FloatArray, cells: int) -> csr_array:
    """(n, cells + 3) cubic B-splines at positions (n,) in knot units, 0 … cells."""
    cell, weights = cell_and_weights(knots, cells)
    rows = np.repeat(np.arange(len(knots)), 4)
    columns = (cell[:, None] + np.arange(4)).ravel()
    return csr_array((weights.ravel(), (rows, columns)), shape=(len(knots), cells + 3))


def cell_and_weights(knots: FloatArray, cells: int) -> tuple[IntArray, FloatArray]:
    """(n,) knot cell of each position, and the (n, 4) values of the B-splines that reach it."""
    cell = np.clip(np.floor(knots).astype(np.int64), 0, cells - 1)
    t = knots - cell
    weights = np.stack(
        [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1
    )
    return cell, weights / 6.0


def _along_axes(matrices: Axes, values: FloatArray) -> FloatArray:
    for axis, matrix in enumerate(matrices):
        values = _along_axis(matrix, values, axis)
    return values


def _along_axis(matrix: csr_array, values: FloatArray, axis: int) -> FloatArray:
    front = np.ascontiguousarray(np.moveaxis(values, axis, 0))
    product = np.asarray(matrix @ front.reshape(len(front), -1))
    return np.moveaxis(product.reshape(-1, *front.shape[1:]), 0, axis)


def _outer(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    return np.asarray(x[:, None, None] * y[:, None] * z)
