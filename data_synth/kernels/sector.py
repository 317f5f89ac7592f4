"""Kernels of the ultrasound simulator, in the order in which a frame is made; `receive` follows."""

import numpy as np
from numba import njit

from dvf_ig.core import AnyArray

from .lookup import cell, nearest

TABLE = 8192
"""Entries in the table of complex normal deviates that lattice hashes point into."""

MIRROR = 0.5
"""An interface whose reflection coefficient exceeds this one is a total reflector: lung or bone."""

_ECHO_REACH = 8
_DIRT_MM = 20.0
_SAME_REFLECTOR = 24
"""Samples by which a reflector may jump between neighbouring lines and still be one surface."""

_U1 = np.uint64(0xFF51AFD7ED558CCD)
_U2 = np.uint64(0xC4CEB9FE1A85EC53)
_UX = np.uint64(0x9E3779B97F4A7C15)
_UY = np.uint64(0xC2B2AE3D27D4EB4F)
_UZ = np.uint64(0x165667B19E3779F9)
_S33 = np.uint64(33)
_MASK = np.uint64(TABLE - 1)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def lattice_hash(i: int, j: int, k: int, seed: np.uint64) -> int:
    """Index into the deviate table for a lattice cell: a 64-bit finaliser, the same on every machine."""
    h = np.uint64(i) * _UX ^ np.uint64(j) * _UY ^ np.uint64(k) * _UZ ^ seed
    h ^= h >> _S33
    h *= _U1
    h ^= h >> _S33
    h *= _U2
    h ^= h >> _S33
    return int(h & _MASK)


@njit(cache=True, nogil=True, error_model="numpy")
def insonify(
    path: AnyArray,
    acoustics: AnyArray,
    map_origin: AnyArray,
    map_inverse: float,
    grain: AnyArray,
    grain_inverse: float,
    step_mm: float,
    frequency: float,
    specular: float,
    power: float,
    tissue: AnyArray,
    blood: AnyArray,
    echo: AnyArray,
    mirror: AnyArray,
) -> None:
    """Amplitudes that return to the probe from each sample of each line.

    Loss accumulates along the line: absorption 2αf, and at each interface the transmission 1 − R² once, with
    R = tanh(½ Δ ln Z) over the whole monotone rise of ln Z. The integral of ∇ln Z along a line does not
    depend on the angle at which it crosses an interface, so what is reflected returns in proportion to the
    cosine between beam and interface normal, to the given power. Muscle's scatter drops by the sine squared
    of the angle between beam and wall normal, in dB.

    Args:
        path: (lines, samples + 1, 3) reference positions of the ends of the samples.
        grain: wall normals, see `fibre_orientation`, from the same origin.
        tissue, blood, echo: (lines, samples) float32 out: scatter amplitudes and specular amplitude.
        mirror: (lines, 3) out: sample of the first total reflector (−1: none), its reflection coefficient,
            and the two-way amplitude of what reaches it.
    """
    samples = tissue.shape[1]
    absorb = -2.0 * frequency * 0.1 * step_mm * np.log(10.0) / 20.0
    for line in range(tissue.shape[0]):
        loss, passed, run, last, seen = 0.0, 1.0, 0.0, 0.0, 1.0
        mirror[line, 0] = -1.0
        for i in range(samples):
            x = 0.5 * (path[line, i, 0] + path[line, i + 1, 0])
            y = 0.5 * (path[line, i, 1] + path[line, i + 1, 1])
            z = 0.5 * (path[line, i, 2] + path[line, i + 1, 2])
            u, fx = cell((x - map_origin[0]) * map_inverse, acoustics.shape[0])
            v, fy = cell((y - map_origin[1]) * map_inverse, acoustics.shape[1])
            w, fz = cell((z - map_origin[2]) * map_inverse, acoustics.shape[2])
            impedance, alpha, muscle, plasma, slope = 0.0, 0.0, 0.0, 0.0, 0.0
            for a in range(2):
                wa = fx if a else 1.0 - fx
                for b in range(2):
                    wb = wa * (fy if b else 1.0 - fy)
                    for e in range(2):
                        share = wb * (fz if e else 1.0 - fz)
                        node = acoustics[u + a, v + b, w + e]
                        impedance += share * node[0]
                        alpha += share * node[1]
                        muscle += share * node[2]
                        plasma += share * node[3]
                        slope += share * node[4]
            rise = impedance - last if i > 0 else 0.0
            last = impedance
            if rise * run < 0.0 or abs(rise) < 1e-5:
                passed *= seen
                run, seen = 0.0, 1.0
            loss += absorb * alpha
            level = np.exp(loss)
            echo[line, i] = 0.0
            after = 0.0
            if run + rise != 0.0:
                before = np.tanh(0.5 * run)
                run += rise
                after = np.tanh(0.5 * run)
                seen = 1.0 - after * after
                facing = min(abs(rise) / (slope * step_mm + 1e-6), 1.0)
                echo[line, i] = specular * abs(after - before) * facing**power * level * passed
            if muscle > 0.0:
                a, b, e = (
                    nearest((x - map_origin[0]) * grain_inverse, grain.shape[0]),
                    nearest((y - map_origin[1]) * grain_inverse, grain.shape[1]),
                    nearest((z - map_origin[2]) * grain_inverse, grain.shape[2]),
                )
                gx, gy, gz = grain[a, b, e, 0], grain[a, b, e, 1], grain[a, b, e, 2]
                drop_db = gx * gx + gy * gy + gz * gz
                if drop_db > 0.0:
                    dx = path[line, i + 1, 0] - path[line, i, 0]
                    dy = path[line, i + 1, 1] - path[line, i, 1]
                    dz = path[line, i + 1, 2] - path[line, i, 2]
                    along = gx * dx + gy * dy + gz * dz
                    drop_db -= along * along / (dx * dx + dy * dy + dz * dz + 1e-12)
                    muscle *= 10.0 ** (-0.05 * drop_db)
            tissue[line, i] = muscle * level * passed * seen
            blood[line, i] = plasma * level * passed * seen
            if mirror[line, 0] < 0.0 and abs(after) > MIRROR:
                mirror[line, 0], mirror[line, 1], mirror[line, 2] = i, after, level * passed


@njit(cache=True, nogil=True, error_model="numpy")
def reverberate(
    mirror: AnyArray, step_mm: float, face: float, dirt: float, tissue: AnyArray, echo: AnyArray
) -> None:
    """Add what a total reflector returns late: (lines, samples) `tissue` and `echo` are added to.

    The pulse bounces between reflector and transducer, so its echo comes back at every multiple of the
    reflector's depth, each time smaller by the face's reflection and the way there and back. Air also sends
    clutter out of itself that dies out over some 20 mm; the shadow of bone stays clean.
    """
    samples = echo.shape[1]
    for line in range(len(mirror)):
        i = int(mirror[line, 0])
        if i < 0:
            continue
        if mirror[line, 1] < 0.0:
            for j in range(i, samples):
                tissue[line, j] += dirt * mirror[line, 2] * np.exp(-(j - i) * step_mm / _DIRT_MM)
        trip = face * abs(mirror[line, 1]) * mirror[line, 2]
        bounce, size = 2, trip
        while i > 2 * _ECHO_REACH and bounce * i + bounce // 2 - _ECHO_REACH < samples and size > 1e-6:
            center = bounce * i + bounce // 2
            for w in range(-_ECHO_REACH, min(_ECHO_REACH + 1, samples - center)):
                if i + w < samples:
                    echo[line, center + w] += size * echo[line, i + w]
            bounce, size = bounce + 1, size * trip


@njit(cache=True, nogil=True, error_model="numpy")
def scatter(
    path: AnyArray,
    tissue: AnyArray,
    blood: AnyArray,
    echo: AnyArray,
    mirror: AnyArray,
    per_mm: AnyArray,
    table: AnyArray,
    seed: np.uint64,
    frame_seed: np.uint64,
    fine: int,
    real: AnyArray,
    imaginary: AnyArray,
) -> None:
    """Complex echoes of the scatterers on a laterally and axially finer raster.

    Tissue scatterers are fixed to lattice cells of the reference heart and move with it; blood is redrawn
    with every frame. A total reflector (`mirror`, see `insonify`) lies as deep on a fine line as its
    neighbours say, so that an oblique one is a line and no comb.

    Args:
        path: (lines, samples + 1, 3) along the lattice's axes, which has `per_mm` (3,) cells a millimetre.
        real, imaginary: (lines·fine, 2·samples) float32, added to: in each row all first halves of the
            samples, then all second halves.
    """
    lines, samples = tissue.shape
    for m in range(lines * fine):
        p = min(max((m + 0.5) / fine - 0.5, 0.0), lines - 1.0)
        left = min(int(p), lines - 2)
        g = p - left
        near = m // fine
        reflector = mirror[near, 0]
        deeper = 0
        if (
            mirror[left, 0] >= 0.0
            and mirror[left + 1, 0] >= 0.0
            and (abs(mirror[left + 1, 0] - mirror[left, 0]) < _SAME_REFLECTOR)
        ):
            deeper = int(np.round(mirror[left, 0] + g * (mirror[left + 1, 0] - mirror[left, 0]) - reflector))
        for i in range(samples):
            t, b, s = tissue[near, i], blood[near, i], echo[near, i]
            if deeper != 0 and i > reflector - _ECHO_REACH + min(deeper, 0):
                s = echo[near, min(max(i - deeper, 0), samples - 1)]
            for half in range(2):
                j = half * samples + i
                if t < 1e-6 and b < 1e-6:
                    real[m, j] += s
                    continue
                f = 0.25 + 0.5 * half
                n1, f1 = (1.0 - g) * (1.0 - f), (1.0 - g) * f
                n2, f2 = g * (1.0 - f), g * f
                near1, far1 = path[left, i], path[left, i + 1]
                near2, far2 = path[left + 1, i], path[left + 1, i + 1]
                u = n1 * near1[0] + f1 * far1[0] + n2 * near2[0] + f2 * far2[0]
                v = n1 * near1[1] + f1 * far1[1] + n2 * near2[1] + f2 * far2[1]
                w = n1 * near1[2] + f1 * far1[2] + n2 * near2[2] + f2 * far2[2]
                ui = np.int64(np.floor(u * per_mm[0]))
                vi = np.int64(np.floor(v * per_mm[1]))
                wi = np.int64(np.floor(w * per_mm[2]))
                re, im = np.float32(s), np.float32(0.0)
                if t >= 1e-6:
                    h = lattice_hash(ui, vi, wi, seed)
                    re += t * table[h, 0]
                    im += t * table[h, 1]
                if b >= 1e-6:
                    h = lattice_hash(ui, vi, wi, frame_seed)
                    re += b * table[h, 0]
                    im += b * table[h, 1]
                real[m, j] += re
                imaginary[m, j] += im


@njit(cache=True, nogil=True, error_model="numpy")
def add_clutter(
    level: AnyArray,
    arc_index: AnyArray,
    depth_index: float,
    table: AnyArray,
    seed: np.uint64,
    real: AnyArray,
    imaginary: AnyArray,
) -> None:
    """Add speckle that stands still before the probe, to rasters as `scatter` has them.

    Args:
        level: (samples,) its amplitude.
        arc_index: (samples,) lattice cells between two fine lines; `depth_index` cells per half sample.
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
