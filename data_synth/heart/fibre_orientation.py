"""Orientation of the heart's muscle fibres: muscle returns less of a beam along its wall.

Fibres lie in the plane of the wall and turn through its thickness: the normal of the wall describes them.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from dvf_ig.core import FloatArray

from .tissue import ANISOTROPY_DB, MUSCLE

STRIDE = 2
"""Nodes of the tissue fields for each node of the orientations; walls turn slowly."""
_SMOOTH_MM = 1.5
_REACH_MM = 4.0
"""Reach of the smoothing, about half a wall: its middle takes the direction of both faces."""
_TENSOR = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def no_fibres() -> NDArray[np.float32]:
    """Return the orientation of a medium without walls: one node that applies everywhere."""
    return np.zeros((1, 1, 1, 3), dtype=np.float32)


def fibre_orientation(codes: NDArray[np.uint8], spacing_mm: float) -> NDArray[np.float32]:
    """Estimate wall normals on every second node, as long as the root of the drop along the wall in dB.

    The normal is the main direction of the smoothed structure tensor of the muscle; its sign has no meaning.
    Without a prevailing direction (apex, junctions) the drop is less.

    Args:
        codes: (nx, ny, nz) tissue codes at end-diastole.
    Returns:
        (ceil(nx/2), ceil(ny/2), ceil(nz/2), 3) float32; 0 away from muscle.
    """
    muscle = np.isin(codes[::STRIDE, ::STRIDE, ::STRIDE], MUSCLE)
    orientation = np.zeros((*muscle.shape, 3), dtype=np.float32)
    if not muscle.any():
        return orientation
    pitch_mm = STRIDE * spacing_mm
    margin = int(np.ceil(2 * _REACH_MM / pitch_mm)) + 1
    voxels = np.argwhere(muscle)
    low, high = np.maximum(voxels.min(axis=0) - margin, 0), voxels.max(axis=0) + margin + 1
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    soft = gaussian_filter(muscle[box].astype(np.float32), _SMOOTH_MM / pitch_mm)
    slope = np.gradient(soft)
    tensor = [gaussian_filter(slope[a] * slope[b], _REACH_MM / pitch_mm) for a, b in _TENSOR]
    near = soft > 0.02
    normals = np.zeros((*soft.shape, 3), dtype=np.float32)
    normals[near] = _main_directions(np.stack([part[near] for part in tensor], axis=-1))
    orientation[box] = np.sqrt(ANISOTROPY_DB) * normals
    return orientation


def _main_directions(tensor: FloatArray) -> FloatArray:
    """Compute (n, 3) first eigenvectors of (n, 6) tensors, as long as they prevail."""
    matrix = np.empty((len(tensor), 3, 3))
    for k, (a, b) in enumerate(_TENSOR):
        matrix[:, a, b] = matrix[:, b, a] = tensor[:, k]
    values, vectors = np.linalg.eigh(matrix)
    prevails = 1.0 - values[:, 1] / np.maximum(values[:, 2], 1e-12)
    return np.asarray(np.sqrt(prevails)[:, None] * vectors[:, :, 2])
