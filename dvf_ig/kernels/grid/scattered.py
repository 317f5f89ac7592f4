"""A tensor product of cubic B-splines at some nodes of the full grid only, and its adjoint.

Row r of an axis has four `weights` for the coefficients from `first[r]` on (as in `kernels.separable`).
"""

from typing import NamedTuple

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.kernels.compiled import kernel


class AxisRows(NamedTuple):
    """First coefficient (s,) and weights (s, 4) of each node along one axis."""

    first: IntArray
    weights: FloatArray


@kernel
def values_at_nodes(
    x: AxisRows, y: AxisRows, z: AxisRows, coefficients: FloatArray, nodes: IntArray, out: FloatArray
) -> None:
    """Evaluate the spline at chosen nodes.

    Args:
        coefficients: (cx, cy, cz).
        nodes: (3, n) index of each node along the three axes.
        out: (n,).
    """
    for n in range(nodes.shape[1]):
        i, j, k = nodes[0, n], nodes[1, n], nodes[2, n]
        a, b, c = x.first[i], y.first[j], z.first[k]
        w0, w1, w2, w3 = z.weights[k, 0], z.weights[k, 1], z.weights[k, 2], z.weights[k, 3]
        total = 0.0
        for p in range(4):
            plane = 0.0
            for q in range(4):
                plane += y.weights[j, q] * (
                    w0 * coefficients[a + p, b + q, c]
                    + w1 * coefficients[a + p, b + q, c + 1]
                    + w2 * coefficients[a + p, b + q, c + 2]
                    + w3 * coefficients[a + p, b + q, c + 3]
                )
            total += x.weights[i, p] * plane
        out[n] = total


@kernel
def add_from_nodes(
    x: AxisRows, y: AxisRows, z: AxisRows, values: FloatArray, nodes: IntArray, out: FloatArray
) -> None:
    """Apply the adjoint of `values_at_nodes`: add (n,) values into (cx, cy, cz), node after node."""
    for n in range(nodes.shape[1]):
        i, j, k = nodes[0, n], nodes[1, n], nodes[2, n]
        a, b, c = x.first[i], y.first[j], z.first[k]
        w0, w1, w2, w3 = z.weights[k, 0], z.weights[k, 1], z.weights[k, 2], z.weights[k, 3]
        for p in range(4):
            plane = values[n] * x.weights[i, p]
            for q in range(4):
                row = plane * y.weights[j, q]
                out[a + p, b + q, c] += row * w0
                out[a + p, b + q, c + 1] += row * w1
                out[a + p, b + q, c + 2] += row * w2
                out[a + p, b + q, c + 3] += row * w3
