"""Failures of the ultrasound image while the recorder continues: noise, black, or a frozen image."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from dvf_ig.core import FloatArray, InvalidInputError

from .probe import FWHM_PER_SIGMA, SectorProbe
from .scan_conversion import ScanConverter
from .sequence import log_compressed

ImageContent = Literal["heart", "noise", "black", "frozen"]

NOISE_DB = -27.0
"""Mean power of the noise relative to myocardium: like blood, 12 dB above black if +21 to −39 dB are
shown."""


@dataclass(frozen=True, slots=True)
class ImageFailureSpec:
    """Content of images from some time to the end.

    Attributes:
        at_share: start of the failure, as a share of the live part.
        shows: "heart" is no failure; "noise" weak noise, redrawn in every image; "black" nothing (a video
            cable out); "frozen" the last image repeated (a frame grabber that hangs).
    """

    at_share: float = 0.5
    shows: ImageContent = "heart"

    def __post_init__(self) -> None:
        if not 0.0 <= self.at_share <= 1.0 or self.shows not in ("heart", "noise", "black", "frozen"):
            raise InvalidInputError(
                f"from {self.at_share:g} of the recording on images show '{self.shows}'; needed 0 to 1, and "
                "heart, noise, black or frozen"
            )


def with_failure(
    images: NDArray[np.uint8],
    probe: SectorProbe,
    t_s: FloatArray,
    spec: ImageFailureSpec,
    seconds: float,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Replace (n, rows, columns) images from the failure on; without a failure return them unchanged.

    Args:
        t_s: (n,) times of the images, increasing.
        seconds: length of the live part.
    """
    first = int(np.searchsorted(t_s, spec.at_share * seconds))
    if spec.shows == "heart" or first == len(images):
        return images
    out = images.copy()
    if spec.shows == "noise":
        out[first:] = noise_images(probe, len(images) - first, rng)
    else:
        out[first:] = 0 if spec.shows == "black" else images[max(first - 1, 0)]
    return out


def noise_images(probe: SectorProbe, count: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Simulate (count, rows, columns) receiver noise of mean power NOISE_DB, independent between lines."""
    sigma = probe.axial_fwhm_mm / FWHM_PER_SIGMA / probe.step_mm
    convert = ScanConverter.of(probe.polar, probe.pixels)
    out = np.empty((count, probe.rows, probe.columns), dtype=np.uint8)
    for image in out:
        parts = gaussian_filter1d(rng.standard_normal((2, probe.lines, probe.samples)), sigma, axis=2)
        power = (parts**2).sum(axis=0)
        level_db = NOISE_DB + 10 * np.log10(power / power.mean() + 1e-12)
        image[:] = convert(log_compressed(level_db.astype(np.float32), probe))
    return out
