"""Geometry of an N-wire phantom: where each diagonal meets the outer wires, and which way the wires run."""

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, NWirePhantom, Wire


def diagonal_crossings(pattern: tuple[Wire, Wire, Wire]) -> tuple[FloatArray, FloatArray]:
    """Intersect the extended diagonal of an N with its first and its last wire: (3,) mm each.

    Raises:
        InvalidInputError: the outer wires are not parallel, or the diagonal does not cross them.
    """
    first, diagonal, last = pattern
    if np.degrees(_angle(_along(first), _along(last))) > 1.0:
        raise InvalidInputError(
            f"wires {first.name} and {last.name} are not parallel; an N pattern needs parallel outer wires, "
            "with the diagonal listed between them"
        )
    return _meeting(diagonal, first), _meeting(diagonal, last)


def wire_directions(phantom: NWirePhantom) -> FloatArray:
    """Compute (wires, 3) unit vectors from front to back."""
    return np.stack([_along(wire) for wire in phantom.wires])


def _meeting(diagonal: Wire, outer: Wire) -> FloatArray:
    """Point of the diagonal's line closest to the outer wire's line."""
    u, v = _along(diagonal), _along(outer)
    between = outer.front_mm - diagonal.front_mm
    b = float(u @ v)
    if 1.0 - b * b < 1e-4:
        raise InvalidInputError(
            f"wire {diagonal.name} runs parallel to {outer.name}; an N pattern needs a diagonal in the middle"
        )
    distance = (between @ u - b * (between @ v)) / (1.0 - b * b)
    point = diagonal.front_mm + distance * u
    gap = float(np.linalg.norm(np.cross(point - outer.front_mm, v)))
    if gap > 1.0:
        raise InvalidInputError(
            f"wire {diagonal.name} passes {gap:.2f} mm from {outer.name}, needed at most 1 mm: the three "
            "wires of an N lie in one plane"
        )
    return np.asarray(point)


def _along(wire: Wire) -> FloatArray:
    step = wire.back_mm - wire.front_mm
    length = float(np.linalg.norm(step))
    if length < 1e-6:
        raise InvalidInputError(f"wire {wire.name} has zero length; give two different end points")
    return np.asarray(step / length)


def _angle(u: FloatArray, v: FloatArray) -> float:
    return float(np.arcsin(min(1.0, float(np.linalg.norm(np.cross(u, v))))))
