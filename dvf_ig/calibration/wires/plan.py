"""An N-wire phantom seen along its wires: its appearance in an image, up to pose and scale."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.calibration.probe.nwire_residuals import diagonal_crossings
from dvf_ig.core import FloatArray, InvalidInputError, NWirePhantom, Wire, read_only_arrays

SAME_MM = 1.0
"""Wires closer than this cannot be distinguished by their position in the image."""

Labelling = tuple[int, int]
"""+1 if the phantom's across (down) axis runs as in PLUS's images, -1 if it runs the other way."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class WirePlan:
    """A phantom with two or more N patterns in the plane across its wires.

    Axes: across, from the first to the last wire of the first pattern; down, from the first to the last
    pattern; along, the direction of the outer wires.

    Attributes:
        outer_mm: (patterns, 2, 2) across and down of the first and the last wire of each pattern.
        across_mm: (patterns, 2) start and end of each diagonal, across.
        along_mm: (patterns, 2) the same, along.
        labellings: orientations of the plan in an image that the outer wires can distinguish.
    """

    outer_mm: FloatArray
    across_mm: FloatArray
    along_mm: FloatArray
    labellings: tuple[Labelling, ...]


def plan_wires(phantom: NWirePhantom, orientation: str = "MF") -> WirePlan:
    """Project a phantom along its wires.

    Args:
        orientation: of the images, as PLUS writes it: columns run from the marked (M) or the unmarked (U)
            side, rows away from the transducer (F) or towards it (N). Anything else counts as "MF".
    Raises:
        InvalidInputError: fewer than two patterns, or wires that do not form N patterns with parallel outer
            wires.
    """
    if len(phantom.patterns) < 2:
        raise InvalidInputError(
            f"the phantom has {len(phantom.patterns)} N pattern; needed at least two to distinguish its "
            "wires in an image: give segmented wire points instead"
        )
    for pattern in phantom.patterns:
        diagonal_crossings(pattern)
    axes = _axes(phantom)
    front = np.stack([[wire.front_mm for wire in pattern] for pattern in phantom.patterns]) @ axes.T
    back = np.stack([[wire.back_mm for wire in pattern] for pattern in phantom.patterns]) @ axes.T
    outer = 0.5 * (front + back)[:, ::2, :2]
    return WirePlan(
        outer_mm=outer,
        across_mm=np.stack([front[:, 1, 0], back[:, 1, 0]], axis=1),
        along_mm=np.stack([front[:, 1, 2], back[:, 1, 2]], axis=1),
        labellings=_distinct(
            outer, (-1 if orientation[:1] == "U" else 1, -1 if orientation[1:2] == "N" else 1)
        ),
    )


def _axes(phantom: NWirePhantom) -> FloatArray:
    """(3, 3) rows across, down, along; a left-handed set if the phantom lists its wires that way."""
    outer = [wire for pattern in phantom.patterns for wire in pattern[::2]]
    directions = np.stack([_direction(wire) for wire in outer])
    directions *= np.sign(directions @ directions[0])[:, None]
    along = directions.mean(axis=0)
    along /= np.linalg.norm(along)
    spread = np.degrees(np.arccos(np.clip(directions @ along, -1, 1))).max()
    if spread > 1.0:
        raise InvalidInputError(
            f"the outer wires of the phantom's N patterns are up to {spread:.1f}° from parallel; needed at "
            "most 1°: check the wires' end points"
        )
    middles = [np.mean([0.5 * (w.front_mm + w.back_mm) for w in p[::2]], axis=0) for p in phantom.patterns]
    first = phantom.patterns[0]
    across = 0.5 * (first[2].front_mm + first[2].back_mm - first[0].front_mm - first[0].back_mm)
    across -= (across @ along) * along
    across /= np.linalg.norm(across)
    down = middles[-1] - middles[0]
    down = down - (down @ along) * along - (down @ across) * across
    if np.linalg.norm(down) < SAME_MM:
        raise InvalidInputError(
            "the phantom's N patterns lie in one plane; needed patterns one below the other"
        )
    return np.stack([across, down / np.linalg.norm(down), along])


def _direction(wire: Wire) -> FloatArray:
    vector = wire.back_mm - wire.front_mm
    return np.asarray(vector / np.linalg.norm(vector))


def _distinct(outer: FloatArray, usual: Labelling) -> tuple[Labelling, ...]:
    """Keep one of the labellings under which the outer wires look the same, the usual one first."""
    points = outer.reshape(-1, 2)
    centered = points - 0.5 * (points.min(axis=0) + points.max(axis=0))
    distinct: list[Labelling] = []
    for across, down in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
        signs = (across * usual[0], down * usual[1])
        looks_like = [np.array(signs) * np.array(other) for other in distinct]
        if not any(_same(centered, centered * flip) for flip in looks_like):
            distinct.append(signs)
    return tuple(distinct)


def _same(a: FloatArray, b: FloatArray) -> bool:
    """Return whether every point of `a` coincides with one of `b`."""
    return bool((np.linalg.norm(a[:, None] - b[None], axis=2).min(axis=1) < SAME_MM).all())
