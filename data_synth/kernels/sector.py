"""Kernels of the phased-sector simulator, in the order in which a frame is made."""

import numpy as np
from numba import njit

from dvf_ig.core import AnyArray

from .lookup import cell, reference_point

TABLE = 8192
"""Entries in the table of complex normal deviates that lattice hashes point into."""

COARSE = 8
"""Samples between two exact pull-backs along a line; straight in between."""

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
def trace_lines(
    origin: AnyArray,
    lateral: AnyArray,
    depth: AnyArray,
    angles: AnyArray,
    step_mm: float,
    displacement: AnyArray,
    motion_origin: AnyArray,
    motion_inverse: float,
    first: AnyArray,
    second: AnyArray,
    weight: AnyArray,
    path: AnyArray,
) -> None:
    """Reference positions `path` (lines, coarse, 3) along each scan line, every COARSE samples."""
    for line in range(len(angles)):
        sx, cx = np.sin(angles[line]), np.cos(angles[line])
        dx = sx * lateral[0] + cx * depth[0]
        dy = sx * lateral[1] + cx * depth[1]
        dz = sx * lateral[2] + cx * depth[2]
        for c in range(path.shape[1]):
            d = COARSE * c * step_mm
            path[line, c, 0], path[line, c, 1], path[line, c, 2] = reference_point(
                origin[0] + d * dx,
                origin[1] + d * dy,
                origin[2] + d * dz,
                displacement,
                motion_origin,
                motion_inverse,
                first[line],
                second[line],
                weight[line],
            )


@njit(cache=True, nogil=True, error_model="numpy")
def insonify(
    path: AnyArray,
    acoustics: AnyArray,
    map_origin: AnyArray,
    map_inverse: float,
    step_mm: float,
    frequency: float,
    specular: float,
    power: float,
    tissue: AnyArray,
    blood: AnyArray,
    echo: AnyArray,
) -> None:
    """Amplitudes that return to the probe from each sample of each line.

    Loss accumulates along the line: absorption 2αf, and at each interface the transmission 1 − R² once, with
    R = tanh(½ Δ ln Z) over the whole monotone rise of ln Z. The integral of ∇ln Z along a line does not
    depend on the angle at which it crosses an interface, so what is reflected returns in proportion to the
    cosine between beam and interface normal, to the given power.

    Args:
        path: (lines, coarse, 3) reference positions.
        tissue, blood, echo: (lines, samples) float32 out: scatter amplitudes and specular amplitude.
    """
    samples = tissue.shape[1]
    absorb = -2.0 * frequency * 0.1 * step_mm * np.log(10.0) / 20.0
    for line in range(tissue.shape[0]):
        loss, passed, run, last, seen = 0.0, 1.0, 0.0, 0.0, 1.0
        for i in range(samples):
            c = i // COARSE
            f = (i - COARSE * c + 0.5) / COARSE
            x = path[line, c, 0] + f * (path[line, c + 1, 0] - path[line, c, 0])
            y = path[line, c, 1] + f * (path[line, c + 1, 1] - path[line, c, 1])
            z = path[line, c, 2] + f * (path[line, c + 1, 2] - path[line, c, 2])
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
            before = np.tanh(0.5 * run)
            run += rise
            after = np.tanh(0.5 * run)
            seen = 1.0 - after * after
            loss += absorb * alpha
            level = np.exp(loss) * passed * seen
            facing = min(abs(rise) / (slope * step_mm + 1e-6), 1.0)
            tissue[line, i] = muscle * level
            blood[line, i] = plasma * level
            echo[line, i] = specular * abs(after - before) * facing**power * np.exp(loss) * passed


@njit(cache=True, nogil=True, error_model="numpy")
def scatter(
    path: AnyArray,
    tissue: AnyArray,
    blood: AnyArray,
    echo: AnyArray,
    lattice_inverse: float,
    table: AnyArray,
    seed: np.uint64,
    frame_seed: np.uint64,
    fine: int,
    real: AnyArray,
    imaginary: AnyArray,
) -> None:
    """Complex echoes of the scatterers on a laterally and axially finer raster.

    Tissue scatterers are fixed to lattice cells of the reference heart and move with it; blood is redrawn
    with every frame. `real`, `imaginary`: (lines·fine, samples·2) float32 out.
    """
    lines, samples = tissue.shape
    for m in range(lines * fine):
        p = min(max((m + 0.5) / fine - 0.5, 0.0), lines - 1.0)
        left = min(int(p), lines - 2)
        g = p - left
        near = m // fine
        for i in range(samples):
            t, b, s = tissue[near, i], blood[near, i], echo[near, i]
            for half in range(2):
                j = 2 * i + half
                if t < 1e-6 and b < 1e-6:
                    real[m, j] = s
                    imaginary[m, j] = 0.0
                    continue
                c = i // COARSE
                f = (i - COARSE * c + 0.25 + 0.5 * half) / COARSE
                n1, f1 = (1.0 - g) * (1.0 - f), (1.0 - g) * f
                n2, f2 = g * (1.0 - f), g * f
                near1, far1 = path[left, c], path[left, c + 1]
                near2, far2 = path[left + 1, c], path[left + 1, c + 1]
                u = n1 * near1[0] + f1 * far1[0] + n2 * near2[0] + f2 * far2[0]
                v = n1 * near1[1] + f1 * far1[1] + n2 * near2[1] + f2 * far2[1]
                w = n1 * near1[2] + f1 * far1[2] + n2 * near2[2] + f2 * far2[2]
                ui = np.int64(np.floor(u * lattice_inverse))
                vi = np.int64(np.floor(v * lattice_inverse))
                wi = np.int64(np.floor(w * lattice_inverse))
                re, im = np.float32(s), np.float32(0.0)
                if t >= 1e-6:
                    h = lattice_hash(ui, vi, wi, seed)
                    re += t * table[h, 0]
                    im += t * table[h, 1]
                if b >= 1e-6:
                    h = lattice_hash(ui, vi, wi, frame_seed)
                    re += b * table[h, 0]
                    im += b * table[h, 1]
                real[m, j] = re
                imaginary[m, j] = im


@njit(cache=True, nogil=True, error_model="numpy", fastmath=False)
def axial_blur(fine_signal: AnyArray, taps: AnyArray, out: AnyArray) -> None:
    """Axial pulse: (m, 2·samples) to (m, samples); `taps` has even length, centred between the two halves."""
    reach = len(taps) // 2
    width = fine_signal.shape[1]
    for m in range(out.shape[0]):
        for i in range(out.shape[1]):
            total = np.float32(0.0)
            start = 2 * i + 1 - reach
            low, high = max(0, -start), min(len(taps), width - start)
            for k in range(low, high):
                total += taps[k] * fine_signal[m, start + k]
            out[m, i] = total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=False)
def lateral_blur(signal: AnyArray, taps: AnyArray, fine: int, out: AnyArray) -> None:
    """Beam pattern: (lines·fine, samples) to (lines, samples); `taps` (k, samples), k even."""
    reach = taps.shape[0] // 2
    rows = signal.shape[0]
    for line in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[line, i] = 0.0
        start = line * fine + fine // 2 - reach
        for k in range(taps.shape[0]):
            row = start + k
            if 0 <= row < rows:
                for i in range(out.shape[1]):
                    out[line, i] += taps[k, i] * signal[row, i]


@njit(cache=True, nogil=True, error_model="numpy")
def detect(
    real: AnyArray,
    imaginary: AnyArray,
    noise: float,
    gain: AnyArray,
    table: AnyArray,
    frame_seed: np.uint64,
    level_db: AnyArray,
) -> None:
    """Receiver noise, time-gain compensation and envelope, in dB re myocardium's scatter amplitude."""
    for line in range(real.shape[0]):
        for i in range(real.shape[1]):
            h = lattice_hash(line, i, 3, frame_seed)
            re = (real[line, i] + noise * table[h, 0]) * gain[i]
            im = (imaginary[line, i] + noise * table[h, 1]) * gain[i]
            level_db[line, i] = 10.0 * np.log10(re * re + im * im + 1e-20)


@njit(cache=True, nogil=True, error_model="numpy")
def scan_convert(grey: AnyArray, line_index: AnyArray, sample_index: AnyArray, out: AnyArray) -> None:
    """Bilinear interpolation of (lines, samples) to pixels; pixels with a negative line index stay 0."""
    lines, samples = grey.shape
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            p = line_index[row, column]
            if p < 0.0:
                out[row, column] = 0
                continue
            q = sample_index[row, column]
            a, b = min(int(p), lines - 2), min(int(q), samples - 2)
            f, g = p - a, q - b
            value = (1.0 - f) * ((1.0 - g) * grey[a, b] + g * grey[a, b + 1]) + f * (
                (1.0 - g) * grey[a + 1, b] + g * grey[a + 1, b + 1]
            )
            out[row, column] = np.uint8(value + 0.5)
