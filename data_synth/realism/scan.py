"""Check of the simulator's scan conversion against a scanner's pair of polar and converted frames."""

import numpy as np
from numpy.typing import NDArray

from data_synth.ultrasound.scan_conversion import PixelGrid, PolarGrid, ScanConverter

from .gates import Gate

REAL_LINES, REAL_SAMPLES = 96, 3640
REAL_POLAR = PolarGrid(REAL_LINES, REAL_SAMPLES, 10.0, 82.0, float(np.deg2rad(75.0)))
REAL_PIXELS = PixelGrid(616, 820, (0.15, 0.15), (410.0, 87.0 - 10.0 / 0.15))
"""Geometry of the PLUS test recording (Ultrasonix BPC8-4/10): the transducer's face at pixel (410, 87)."""


def real_pair_gates(polar: NDArray[np.uint8], converted: NDArray[np.uint8]) -> list[Gate]:
    """Check the smallest correlation over frames, inside the sector, of our and the recorded conversion.

    Args:
        polar: (n, 96, 3640) recorded lines.
        converted: (n, 616, 820) the recorder's conversion.
    """
    convert = ScanConverter.of(REAL_POLAR, REAL_PIXELS)
    inside = convert.line >= 0
    scores = [
        float(np.corrcoef(convert(lines.astype(np.float32))[inside], image[inside])[0, 1])
        for lines, image in zip(polar, converted, strict=True)
    ]
    return [Gate("scan conversion, r with the real pair", min(scores), 0.95, 1.0)]
