"""Whether ECG and images agree on when the heart moves, as far as the images show it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.mesh import Mesh
from dvf_ig.registration.lc2.slices import fan_mask_from_images

from .ecg_delay import (
    LATE_S,
    CycleSpeed,
    EcgDelay,
    delay_drift_s,
    ecg_delay,
    image_change,
    speed_between,
)
from .findings import Disagreement, Finding, finding
from .parts import SessionFiles
from .preop import PreopFiles

MOST_POINTS = 2000
"""Points of a surface whose distance from the next one is measured."""


@dataclass(frozen=True, slots=True)
class HeartInImages:
    """Delay and drift of the ECG's clock against the images.

    Attributes:
        delay: of the ECG.
        drift_s: by which it grows within the recording; None if it is not known.
    """

    delay: EcgDelay
    drift_s: float | None

    @property
    def sentence(self) -> str:
        """Delay in words."""
        if not self.delay.known:
            return "not known: the images hardly change with the heart (small motion, or a probe that moves)"
        which = "late" if self.delay.delay_s > 0 else "early"
        return f"ECG {1e3 * abs(self.delay.delay_s):.0f} ms {which} against the heart's motion in the images"

    def values(self) -> dict[str, float | bool | None]:
        """The numbers, as JSON; a delay that is not known is None."""
        known = self.delay.known
        return {
            "delay_s": self.delay.delay_s if known else None,
            "drift_s": self.drift_s,
            "log_likelihood_ratio": self.delay.cyclic_log_ratio if known else None,
        }


def heart_in_images(files: SessionFiles, peaks_s: FloatArray) -> HeartInImages | None:
    """Compare them; None without images, their calibration and latency, or the heart's motion.

    Args:
        peaks_s: (k,) R peaks of the ECG.
    """
    sweep, heart = files.sweep, None if files.preop is None else heart_speed(files.preop)
    if sweep is None or heart is None or sweep.recorded.images is None or len(sweep.recorded) < 2:
        return None
    if not isinstance(files.probe, ImageMap) or not isinstance(files.latency, float) or not len(peaks_s):
        return None
    images = sweep.recorded.images
    fan = files.fan
    shown = fan_mask_from_images(images) if fan is None else fan.mask(*images.shape[1:])
    change = image_change(sweep.recorded, sweep.probe, files.probe, shown)
    return HeartInImages(
        ecg_delay(change, files.latency, peaks_s, heart),
        delay_drift_s(change, files.latency, peaks_s, heart),
    )


def heart_speed(heart: PreopFiles) -> CycleSpeed | None:
    """How fast the heart moves over its cycle, by its labels, its model or its surfaces."""
    preop, model = heart.preop, heart.model
    if preop.labels is not None:
        values = preop.labels.values
        changed = [np.count_nonzero(values[i - 1] != values[i]) for i in range(len(values))]
        amounts = np.roll(np.array(changed, dtype=np.float64), -1)
        return speed_between(amounts, preop.labels.timing.fractions)
    if model is not None:
        vertices = [mesh.vertices_mm for mesh in model.reference]
        if len({len(xyz_mm) for xyz_mm in vertices}) == 1:
            return speed_between(_between_surfaces(np.stack(vertices)), model.timing.fractions)
        return speed_between(_between_others(model.reference), model.timing.fractions)
    surface = next((series for series in preop.surfaces if series.name == preop.surface), None)
    if surface is None:
        return None
    return speed_between(_between_surfaces(surface.vertices_mm), surface.timing.fractions)


def _between_surfaces(vertices_mm: FloatArray) -> FloatArray:
    """(m,) mean distance of the vertices of each of (m, n, 3) phases from those of the next, mm."""
    step = np.roll(vertices_mm, -1, axis=0) - vertices_mm
    return np.asarray(np.linalg.norm(step, axis=2).mean(axis=1))


def _between_others(surfaces: tuple[Mesh, ...]) -> FloatArray:
    """(m,) the same along the normals, where vertices do not correspond: to the plane at the nearest one."""
    out = []
    for here, there in zip(surfaces, (*surfaces[1:], surfaces[0]), strict=True):
        points = here.vertices_mm[:: max(1, len(here.vertices_mm) // MOST_POINTS)]
        centers = there.vertices_mm[there.triangles].mean(axis=1)
        corners = there.vertices_mm[there.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        nearest = cKDTree(centers).query(points)[1]
        out.append(np.abs(((points - centers[nearest]) * normals[nearest]).sum(axis=1)).mean())
    return np.array(out)


def cycle_findings(seen: HeartInImages | None) -> Iterator[Finding]:
    """Find what is wrong with the ECG's clock by the images."""
    if seen is None:
        return
    delay = seen.delay
    if delay.suspicious:
        cause = Disagreement.ECG_LATE if delay.certain else Disagreement.ECG_PERHAPS_LATE
        which = "late" if delay.delay_s > 0 else "early"
        yield finding(cause, "ecg", ms=1e3 * abs(delay.delay_s), which=which)
    if seen.drift_s is not None and abs(seen.drift_s) > LATE_S:
        yield finding(Disagreement.ECG_DRIFTS, "ecg", ms=1e3 * abs(seen.drift_s))
