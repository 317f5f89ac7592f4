"""Vectors of three as tuples, for kernels."""

from dvf_ig.core import FloatArray

from .compiled import inlined

Vector = tuple[float, float, float]


@inlined
def vector_at(numbers: FloatArray, at: int) -> Vector:
    """Read three consecutive numbers."""
    return numbers[at], numbers[at + 1], numbers[at + 2]


@inlined
def dot(a: Vector, b: Vector) -> float:
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
