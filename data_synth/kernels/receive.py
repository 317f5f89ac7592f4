"""Kernels that turn scatterers' echoes into an envelope: beam, pulse, noise, gain."""

import numpy as np

from dvf_ig.core import AnyArray

from .compiled import kernel
from .speckle import lattice_hash


@kernel(nogil=True, error_model="numpy", fastmath=False)
def axial_blur(halves: AnyArray, taps: AnyArray, out: AnyArray) -> None:
    """Apply the axial pulse: (m, 2·samples) in the layout of `scatter` to (m, samples).

    `taps` has even length, centred between the two halves of a sample.
    """
    reach = len(taps) // 2
    samples = out.shape[1]
    for m in range(out.shape[0]):
        for i in range(samples):
            out[m, i] = 0.0
        for k in range(len(taps)):
            shift = k + 1 - reach
            ahead, base = shift >> 1, (shift & 1) * samples
            for i in range(max(0, -ahead), min(samples, samples - ahead)):
                out[m, i] += taps[k] * halves[m, base + i + ahead]


@kernel(nogil=True, error_model="numpy", fastmath=False)
def lateral_blur(signal: AnyArray, taps: AnyArray, fine: int, out: AnyArray) -> None:
    """Apply the beam pattern: (lines·fine, n) to (lines, n); `taps` (k, n), k even."""
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


@kernel(nogil=True, error_model="numpy")
def detect(
    real: AnyArray,
    imaginary: AnyArray,
    noise: float,
    gain: AnyArray,
    band: int,
    table: AnyArray,
    frame_seed: np.uint64,
    envelope: AnyArray,
) -> None:
    """Add receiver noise, compensate gain, and add the envelope to `envelope`."""
    for line in range(real.shape[0]):
        for i in range(real.shape[1]):
            h = lattice_hash(line, i, 3 + band, frame_seed)
            re = (real[line, i] + noise * table[h, 0]) * gain[i]
            im = (imaginary[line, i] + noise * table[h, 1]) * gain[i]
            envelope[line, i] += np.sqrt(re * re + im * im)


@kernel(nogil=True, error_model="numpy")
def decibel(envelope: AnyArray, scale: float) -> None:
    """Convert in place to 20 log10 of the scaled envelope, at least −200."""
    for line in range(envelope.shape[0]):
        for i in range(envelope.shape[1]):
            envelope[line, i] = 20.0 * np.log10(max(envelope[line, i] * scale, 1e-10))


@kernel(nogil=True, error_model="numpy")
def fill_middles(path: AnyArray, stride: int) -> None:
    """Put the point half-way between every `stride`-th point of (lines, count, 3) paths into their middle."""
    half = stride // 2
    for line in range(path.shape[0]):
        for i in range(0, path.shape[1] - stride, stride):
            for k in range(3):
                path[line, i + half, k] = 0.5 * (path[line, i, k] + path[line, i + stride, k])
