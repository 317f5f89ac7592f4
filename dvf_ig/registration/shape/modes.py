"""Modes of a smooth change of shape: those that move the walls most, without the rigid part.

A Gaussian process a priori, smooth over LENGTH_MM and of every direction, written on nodes (Williams and
Seeger 2001) and turned so that each mode moves the walls less than the one before (Lüthi et al. 2018). The
rigid motion that fits each mode best over the walls is taken out of it: that motion is the pose.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.registration.pose_chart import rigid_motion

LENGTH_MM = 35.0
"""Length over which changes of shape are smooth. On tuning hearts 1001 and 1002, 5 mm different over 30 mm,
45 mm leave 0.1 mm more where the wall is seen, with standard deviations further below the errors."""
NODES_PER_AXIS = 6
MARGIN_MM = 15.0
"""Nodes reach so far beyond the walls."""
LEAST_SHARE = 1e-4
"""Directions of the nodes with less than this share of the largest variance are left out."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ShapeModes:
    """Modes of unit variance; a change of s mm RMS has coefficients of standard deviation s.

    Attributes:
        nodes_mm: (g, 3); whitened: (g, s) scalar fields from correlations with the nodes.
        rigid_part: (6, s, 3) motion that each field, along each axis, contains.
        rotation: (3 s, m) modes, the one that moves the walls most first.
        center_mm: (3,) about which rigid motion turns.
    """

    nodes_mm: FloatArray
    whitened: FloatArray
    rigid_part: FloatArray
    rotation: FloatArray
    center_mm: FloatArray

    def at(self, places_mm: FloatArray, count: int) -> FloatArray:
        """(n, 3, count) displacement of the first modes at (n, 3) places."""
        return self._displaced(places_mm, self.rotation[:, :count])

    def displacement(self, places_mm: FloatArray, coefficients: FloatArray) -> FloatArray:
        """(n, 3) displacement at (n, 3) places by the first modes together, with (k,) coefficients."""
        return self._displaced(places_mm, self.rotation[:, : len(coefficients)] @ coefficients[:, None])[
            ..., 0
        ]

    def variance_along(self, places_mm: FloatArray, directions: FloatArray) -> FloatArray:
        """(n,) variance of all modes together at (n, 3) places along (n, 3) directions."""
        scalar = self._scalar(places_mm)
        moved = np.einsum("ni,nip->np", directions, rigid_motion(places_mm, self.center_mm))
        flat = self.rigid_part.reshape(6, -1)
        mixed = np.einsum("ni,npi->np", directions, np.tensordot(scalar, self.rigid_part, axes=(1, 1)))
        own = (directions**2).sum(axis=1) * (scalar**2).sum(axis=1)
        return np.asarray(own + np.einsum("np,np->n", moved, moved @ (flat @ flat.T) - 2.0 * mixed))

    def _displaced(self, places_mm: FloatArray, rotation: FloatArray) -> FloatArray:
        """(n, 3, k) displacement at (n, 3) places by (3 s, k) combinations of the fields along each axis."""
        moved = np.tensordot(self._scalar(places_mm), rotation.reshape(-1, 3, rotation.shape[1]), axes=1)
        rigid = self.rigid_part.reshape(6, -1) @ rotation
        return np.asarray(moved - rigid_motion(places_mm, self.center_mm) @ rigid)

    def _scalar(self, places_mm: FloatArray) -> FloatArray:
        """(n, s) fields at (n, 3) places."""
        return np.asarray(_correlation(places_mm, self.nodes_mm) @ self.whitened)


def shape_modes(walls_mm: FloatArray, center_mm: FloatArray) -> ShapeModes:
    """Build the modes over (n, 3) places in the walls."""
    low, high = walls_mm.min(axis=0) - MARGIN_MM, walls_mm.max(axis=0) + MARGIN_MM
    axes = np.linspace(low, high, NODES_PER_AXIS).T
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    values, vectors = np.linalg.eigh(_correlation(nodes, nodes))
    kept = values > LEAST_SHARE * values[-1]
    whitened = vectors[:, kept] / np.sqrt(values[kept])
    scalar = _correlation(walls_mm, nodes) @ whitened
    fit = np.linalg.pinv(rigid_motion(walls_mm, center_mm).reshape(-1, 6)).reshape(6, -1, 3)
    rigid_part = np.einsum("pnd,ns->psd", fit, scalar, optimize=True)
    # Gram matrix of the fields over the walls: that of the scalars on each axis, less the rigid parts
    gram = np.kron(scalar.T @ scalar, np.eye(3))
    motion = rigid_motion(walls_mm, center_mm).reshape(-1, 6)
    flat = rigid_part.reshape(6, -1)
    gram -= flat.T @ (motion.T @ motion) @ flat
    order = np.linalg.eigh(0.5 * (gram + gram.T))[1][:, ::-1]
    return ShapeModes(nodes, whitened, rigid_part, order, np.array(center_mm))


def _correlation(a_mm: FloatArray, b_mm: FloatArray) -> FloatArray:
    """(n, m) covariance between (n, 3) and (m, 3) places of one coordinate, of 1 mm RMS in space."""
    apart = (a_mm**2).sum(axis=1)[:, None] + (b_mm**2).sum(axis=1)[None] - 2.0 * a_mm @ b_mm.T
    return np.asarray(np.exp(-0.5 * np.maximum(apart, 0.0) / LENGTH_MM**2) / 3.0)
