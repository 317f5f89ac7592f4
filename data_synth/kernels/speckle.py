"""Speckle: complex echoes of scatterers on a lattice, on a raster finer than the scan lines."""

from typing import NamedTuple

import numpy as np

from dvf_ig.core import AnyArray

from .compiled import kernel
from .insonification import ECHO_REACH, Amplitudes
from .interpolation import Point

TABLE = 8192
"""Entries in the table of complex normal deviates, which lattice hashes index."""

_SAME_REFLECTOR = 24
"""Largest jump, in samples, of a reflector between neighbouring lines that is still one surface."""

_U1 = np.uint64(0xFF51AFD7ED558CCD)
_U2 = np.uint64(0xC4CEB9FE1A85EC53)
_UX = np.uint64(0x9E3779B97F4A7C15)
_UY = np.uint64(0xC2B2AE3D27D4EB4F)
_UZ = np.uint64(0x165667B19E3779F9)
_S33 = np.uint64(33)
_MASK = np.uint64(TABLE - 1)


class Scatterers(NamedTuple):
    """Assignment of deviates to lattice cells.

    Attributes:
        per_mm: (3,) cells a millimetre along the lattice's axes.
        deviates: (TABLE, 2) float32 complex normal deviates of unit power.
        tissue_seed: seed of the scatterers of tissue, which move with it.
        blood_seed: seed of those of blood, which are drawn for each frame.
    """

    per_mm: AnyArray
    deviates: AnyArray
    tissue_seed: np.uint64
    blood_seed: np.uint64


@kernel(nogil=True, error_model="numpy", inline="always")
def lattice_hash(i: int, j: int, k: int, seed: np.uint64) -> int:
    """Compute a lattice cell's index in the deviate table by a 64-bit finaliser, equal on all machines."""
    h = np.uint64(i) * _UX ^ np.uint64(j) * _UY ^ np.uint64(k) * _UZ ^ seed
    h ^= h >> _S33
    h *= _U1
    h ^= h >> _S33
    h *= _U2
    h ^= h >> _S33
    return int(h & _MASK)


@kernel(nogil=True, error_model="numpy")
def scatter(
    path: AnyArray,
    amplitudes: Amplitudes,
    scatterers: Scatterers,
    fine: int,
    real: AnyArray,
    imaginary: AnyArray,
) -> None:
    """Compute complex echoes of the scatterers on a laterally and axially finer raster.

    Tissue scatterers are fixed to lattice cells of the reference heart and move with it; blood is redrawn
    with every frame.

    Args:
        path: (lines, samples + 1, 3) along the lattice's axes.
        fine: fine lines for each scan line.
        real, imaginary: (lines·fine, 2·samples) float32, added to: in each row all first halves of the
            samples, then all second halves.
    """
    # arrays are taken out of the tuples once: each access counts a reference
    tissue, blood, interface = amplitudes.tissue, amplitudes.blood, amplitudes.interface
    reflector, table = amplitudes.reflector, scatterers.deviates
    per_x, per_y, per_z = scatterers.per_mm[0], scatterers.per_mm[1], scatterers.per_mm[2]
    tissue_seed, blood_seed = scatterers.tissue_seed, scatterers.blood_seed
    lines, samples = tissue.shape
    for m in range(lines * fine):
        p = min(max((m + 0.5) / fine - 0.5, 0.0), lines - 1.0)
        left = min(int(p), lines - 2)
        g, near = p - left, m // fine
        deeper = _deeper(reflector, left, g, near)
        moved_from = reflector[near, 0] - ECHO_REACH + min(deeper, 0)
        for i in range(samples):
            t, b, s = tissue[near, i], blood[near, i], interface[near, i]
            if deeper != 0 and i > moved_from:
                s = interface[near, min(max(i - deeper, 0), samples - 1)]
            for half in range(2):
                j = half * samples + i
                if t < 1e-6 and b < 1e-6:
                    real[m, j] += s
                    continue
                u, v, w = _between(path, left, i, g, 0.25 + 0.5 * half)
                ui = np.int64(np.floor(u * per_x))
                vi = np.int64(np.floor(v * per_y))
                wi = np.int64(np.floor(w * per_z))
                re, im = np.float32(s), np.float32(0.0)
                if t >= 1e-6:
                    h = lattice_hash(ui, vi, wi, tissue_seed)
                    re += t * table[h, 0]
                    im += t * table[h, 1]
                if b >= 1e-6:
                    h = lattice_hash(ui, vi, wi, blood_seed)
                    re += b * table[h, 0]
                    im += b * table[h, 1]
                real[m, j] += re
                imaginary[m, j] += im


@kernel(nogil=True, error_model="numpy")
def _deeper(reflector: AnyArray, left: int, g: float, near: int) -> int:
    """Compute by how many samples a total reflector is deeper on a fine line than on the nearest scan line.

    Its depth is interpolated between scan lines, so that an oblique one is a line, not a comb.
    """
    one, other = reflector[left, 0], reflector[left + 1, 0]
    if one >= 0.0 and other >= 0.0 and abs(other - one) < _SAME_REFLECTOR:
        return int(np.round(one + g * (other - one) - reflector[near, 0]))
    return 0


@kernel(nogil=True, error_model="numpy", inline="always")
def _between(path: AnyArray, left: int, i: int, g: float, f: float) -> Point:
    """Interpolate between scan lines `left` and the next (share g) and between ends i and i + 1 (share f)."""
    n1, f1 = (1.0 - g) * (1.0 - f), (1.0 - g) * f
    n2, f2 = g * (1.0 - f), g * f
    near1, far1 = path[left, i], path[left, i + 1]
    near2, far2 = path[left + 1, i], path[left + 1, i + 1]
    return (
        n1 * near1[0] + f1 * far1[0] + n2 * near2[0] + f2 * far2[0],
        n1 * near1[1] + f1 * far1[1] + n2 * near2[1] + f2 * far2[1],
        n1 * near1[2] + f1 * far1[2] + n2 * near2[2] + f2 * far2[2],
    )


@kernel(nogil=True, error_model="numpy")
def add_clutter(
    level: AnyArray,
    arc_index: AnyArray,
    depth_index: float,
    table: AnyArray,
    seed: np.uint64,
    real: AnyArray,
    imaginary: AnyArray,
) -> None:
    """Add speckle fixed in front of the probe to rasters in the layout of `scatter`.

    Args:
        level: (samples,) amplitude of the speckle.
        arc_index: (samples,) lattice cells between two fine lines; `depth_index` cells per half sample.
        table: (TABLE, 2) deviates.
    """
    samples = len(level)
    for m in range(real.shape[0]):
        for i in range(samples):
            if level[i] < 1e-6:
                continue
            arc = np.int64(m * arc_index[i])
            for half in range(2):
                h = lattice_hash(arc, np.int64((2 * i + half) * depth_index), 1, seed)
                real[m, half * samples + i] += level[i] * table[h, 0]
                imaginary[m, half * samples + i] += level[i] * table[h, 1]
