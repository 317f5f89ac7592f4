"""Lattice of scatterers for one image slice, with cells as thick as the slice.

A slice some millimetres thick sums all scatterers across its thickness, so that its speckle stays while
tissue moves less than that out of the plane. If one plane represents the whole slice, its scatterers must be
those sums: cells fine in the plane and long across it. The cells belong to the tissue and cannot turn
with each image, so they have one of a few fixed orientations: the one nearest to the slice's.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, read_only_arrays

from .beam import LATTICE_MM
from .probe import SectorProbe

_COUNT = 24
"""Orientations over the half sphere; a slice is never more than some 20° from one."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Lattice of scatterers: its orientation and its cells.

    Attributes:
        number: index of the orientation; each has its own texture.
        axes: (3, 3) unit rows, two in the cells' plane and one across, frame "mr".
        per_mm: (3,) cells a millimetre along the axes.
    """

    number: int
    axes: FloatArray
    per_mm: FloatArray


def fine_lattice() -> Lattice:
    """Return cubic cells along patient axes, for beams that resolve elevation themselves."""
    return Lattice(0, np.eye(3), np.full(3, 1.0 / LATTICE_MM))


def slice_lattice(probe: SectorProbe, normal: FloatArray) -> Lattice:
    """Choose the lattice of an image plane with this (3,) unit normal, frame "mr"."""
    if probe.elevation_planes > 1:
        return fine_lattice()
    number = int(np.abs(_NORMALS @ normal).argmax())
    across = _NORMALS[number]
    first = np.cross(across, np.eye(3)[np.abs(across).argmin()])
    first /= np.linalg.norm(first)
    thick_mm = float(np.median(probe.elevation_fwhm_mm(probe.depths_mm)))
    per_mm = 1.0 / np.array([LATTICE_MM, LATTICE_MM, thick_mm])
    return Lattice(number, np.stack([first, np.cross(across, first), across]), per_mm)


def _half_sphere() -> FloatArray:
    """List (_COUNT, 3) unit vectors spread evenly over the upper half."""
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(_COUNT)
    height = 1 - (np.arange(_COUNT) + 0.5) / _COUNT
    ring = np.sqrt(1 - height**2)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])


_NORMALS = _half_sphere()
