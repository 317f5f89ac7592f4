"""What the slices of a registration are like: images unlike all that was calibrated are told by it."""

from dataclasses import asdict, dataclass

import numpy as np

from dvf_ig.registration.lc2.slices import SliceSet


@dataclass(frozen=True, slots=True)
class ImageStatistics:
    """Statistics of the slices at the coarse pitch, and of how they lie to the model.

    Attributes:
        brightness, contrast: mean of what was insonified, and its standard deviation as a share of that mean.
        structure: correlation of neighbouring pixels, across and down: 0 of noise, near 1 of smooth images.
        fill: share of the insonified pixels brighter than a twentieth of the brightest.
        slices: how many.
        view_spread_deg: RMS angle of the slices' normals from their principal direction.
        extent_mm: RMS distance of the slices' centres from their mean.
        similarity: LC2 at the pose; overlap: share of the slices inside the model's volume.
        information: number of observations that LC2 counts.
    """

    brightness: float
    contrast: float
    structure: float
    fill: float
    slices: float
    view_spread_deg: float
    extent_mm: float
    similarity: float
    overlap: float
    information: float

    def values(self) -> dict[str, float]:
        """By name."""
        return asdict(self)


def image_statistics(
    slices: SliceSet, *, similarity: float, overlap: float, information: float
) -> ImageStatistics:
    """Statistics of a slice set; see `ImageStatistics`."""
    masks, images = slices.masks, slices.images.astype(np.float64)
    lit = images[masks] if masks.any() else np.zeros(1)
    mean, deviation = float(lit.mean()), float(lit.std())
    centred = np.where(masks, images - mean, 0.0)
    pairs = [
        (centred[:, 1:] * centred[:, :-1], masks[:, 1:] & masks[:, :-1]),
        (centred[:, :, 1:] * centred[:, :, :-1], masks[:, :, 1:] & masks[:, :, :-1]),
    ]
    products = sum(float(product[both].sum()) for product, both in pairs)
    count = sum(int(both.sum()) for _, both in pairs)
    rows, columns = images.shape[1:]
    middle = np.array([(columns - 1) / 2, (rows - 1) / 2, 1.0])
    centers = slices.frame_from_pixel @ middle
    return ImageStatistics(
        brightness=mean,
        contrast=deviation / max(mean, 1e-12),
        structure=products / max(count, 1) / max(deviation**2, 1e-12),
        fill=float((lit > 0.05 * lit.max()).mean()),
        slices=float(len(slices)),
        view_spread_deg=_view_spread_deg(slices),
        extent_mm=float(np.sqrt(((centers - centers.mean(axis=0)) ** 2).sum(axis=1).mean())),
        similarity=similarity,
        overlap=overlap,
        information=information,
    )


def _view_spread_deg(slices: SliceSet) -> float:
    """Normals count as axes: a slice and its mirror image are one plane."""
    normals = np.cross(slices.frame_from_pixel[:, :, 0], slices.frame_from_pixel[:, :, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    principal = np.linalg.eigh(normals.T @ normals)[1][:, -1]
    angles = np.arccos(np.clip(np.abs(normals @ principal), 0.0, 1.0))
    return float(np.degrees(np.sqrt(np.mean(angles**2))))
