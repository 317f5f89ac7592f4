"""Banded products and solves along an axis, and splines at some nodes, against dense matrices."""

import numpy as np
import pytest

from dvf_ig.kernels.grid.scattered import AxisRows, add_from_nodes, values_at_nodes
from dvf_ig.preop import AxisSolver
from dvf_ig.preop.banded import BandedRows

SHAPE = (5, 7, 6)


def banded(rows: int, columns: int, window: int, rng: np.random.Generator) -> BandedRows:
    first = rng.integers(0, columns - window + 1, rows)
    weights = rng.normal(size=(rows, window)) * (rng.random((rows, window)) > 0.2)
    return BandedRows(first, weights, columns)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("window", [1, 4, 5])
def test_products_along_an_axis(axis: int, window: int) -> None:
    rng = np.random.default_rng(axis + 10 * window)
    values = rng.normal(size=SHAPE)
    matrix = banded(9, SHAPE[axis], window, rng)
    expected = np.moveaxis(np.tensordot(matrix.dense(), values, (1, axis)), 0, axis)
    np.testing.assert_allclose(matrix.along(axis, values), expected, atol=1e-12)
    back = np.moveaxis(np.tensordot(matrix.dense().T, expected, (1, axis)), 0, axis)
    np.testing.assert_allclose(matrix.transposed_along(axis, expected), back, atol=1e-12)


@pytest.mark.parametrize("order", ["C", "F"])
def test_any_memory_order_and_read_only_arrays(order: str) -> None:
    rng = np.random.default_rng(3)
    values = np.array(rng.normal(size=SHAPE), order=order)
    values.setflags(write=False)
    matrix = banded(4, SHAPE[1], 3, rng)
    expected = np.einsum("rc,acb->arb", matrix.dense(), values)
    np.testing.assert_allclose(matrix.along(1, values), expected, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_solve_along_an_axis(axis: int) -> None:
    solver = AxisSolver.of(SHAPE[axis] - 3)
    normal = solver.normal.dense()
    np.testing.assert_allclose(normal, solver.basis.dense().T @ solver.basis.dense(), atol=1e-15)
    right = np.random.default_rng(axis).normal(size=SHAPE)
    expected = np.moveaxis(np.tensordot(np.linalg.inv(normal), right, (1, axis)), 0, axis)
    solver.solve_normal(axis, right)
    np.testing.assert_allclose(right, expected, atol=1e-9)


def test_values_and_adjoint_at_some_nodes() -> None:
    rng = np.random.default_rng(4)
    x, y, z = (AxisSolver.of(cells).basis for cells in (3, 4, 5))
    full = np.kron(x.dense(), np.kron(y.dense(), z.dense()))
    shape = (len(x.first), len(y.first), len(z.first))
    nodes = np.stack(np.unravel_index(rng.permutation(np.prod(shape))[:60], shape))
    rows = full[np.ravel_multi_index(tuple(nodes), shape)]
    a, b, c = (AxisRows(s.first.copy(), s.weights.copy()) for s in (x, y, z))
    coefficients, out = rng.normal(size=(6, 7, 8)), np.empty(60)
    values_at_nodes(a, b, c, coefficients, nodes, out)
    np.testing.assert_allclose(out, rows @ coefficients.ravel(), atol=1e-12)
    back = np.zeros((6, 7, 8))
    add_from_nodes(a, b, c, out, nodes, back)
    np.testing.assert_allclose(back.ravel(), rows.T @ out, atol=1e-12)
