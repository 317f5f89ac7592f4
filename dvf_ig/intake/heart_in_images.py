"""Whether ECG and images agree on when the heart moves, as far as the images show it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from dvf_ig.core import BoolArray, FloatArray, ImageMap, Mesh, PoseStream
from dvf_ig.registration.lc2.slices import fan_mask_from_images

from .ecg_delay import (
    LATE_S,
    LEAST_PAIRS,
    SHIFTS,
    CycleSpeed,
    EcgDelay,
    ImageChange,
    delay_drift_s,
    ecg_delay,
    grid_mm,
    image_change,
    moved_between_mm,
    residual_of_fit,
    speed_between,
    without_heart,
)
from .findings import Disagreement, Finding, finding
from .own_rhythm import OwnRhythm, best_stretch, own_rhythm
from .parts import SessionFiles
from .preop import PreopFiles

MOST_POINTS = 2000
"""Points of a surface whose distance from the next one is measured."""

SAME_S = 0.03
"""A delay this near to twice the latency is the latency's sign; a latency below it is none to confuse."""
LEAST_SWING = 0.1
"""Share of its blood that a heart ejects at least; a model whose volume changes less shows no order."""
LATEST_LARGEST = 0.2
"""A heart is fullest within this share of the cycle about the R peak, also where a trigger is late."""
LONGEST_EMPTYING = 0.6
MOST_TRAVEL = 3.0
"""Sum of the changes of volume as a multiple of its range: 2 for one emptying and filling."""
FEWEST_PHASES, MOST_SIDE = 8, 24
"""Phases, and samples along each side of the heart, that are compared."""
FITS, FITS_BETTER = 0.7, 0.4
"""Correlations of changes of grey levels with the model's motion: at the best shift, and above none."""


@dataclass(frozen=True, slots=True)
class HeartInImages:
    """Delay and drift of the ECG's clock against the images, and their own rhythm.

    Attributes:
        delay: of the ECG.
        drift_s: by which it grows within the recording; None if it is not known.
        own: rhythm of the images alone; None if there are too few.
        stretch: factor on the ECG's times that makes them agree, where its beats contradict the images.
        reversed_latency: log-likelihood ratio of the latency's other sign, by the probe's motion.
    """

    delay: EcgDelay
    drift_s: float | None
    own: OwnRhythm | None = None
    stretch: float | None = None
    reversed_latency: float = 0.0

    @property
    def contradicted(self) -> bool:
        """Whether the images beat at other times than the ECG says, at any delay."""
        return self.own is not None and self.own.contradicts(self.delay)

    @property
    def sentence(self) -> str:
        """Delay in words."""
        if self.own is not None and self.contradicted:
            return f"the images beat about {60.0 / self.own.rr_s:.0f} times a minute, not as this ECG"
        if not self.delay.known:
            return "not known: the images hardly change with the heart (small motion, or a probe that moves)"
        which = "late" if self.delay.delay_s > 0 else "early"
        return f"ECG {1e3 * abs(self.delay.delay_s):.0f} ms {which} against the heart's motion in the images"

    def values(self) -> dict[str, float | bool | None]:
        """The numbers, as JSON; a delay that is not known is None."""
        is_known = self.delay.known
        return {
            "delay_s": self.delay.delay_s if is_known else None,
            "drift_s": self.drift_s,
            "log_likelihood_ratio": self.delay.cyclic_log_ratio if is_known else None,
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
    seen = HeartInImages(
        ecg_delay(change, files.latency, peaks_s, heart),
        delay_drift_s(change, files.latency, peaks_s, heart),
        own_rhythm(change, files.latency, peaks_s, heart),
        reversed_latency=reversed_log_ratio(change, sweep.probe, files.probe, shown.shape, files.latency),
    )
    if seen.own is None or not seen.contradicted:
        return seen
    return replace(seen, stretch=best_stretch(change, files.latency, peaks_s, heart, seen.own))


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


def cycle_findings(seen: HeartInImages | None, files: SessionFiles) -> Iterator[Finding]:
    """Find what is wrong with the ECG, with the latency, or with the order of the phases, by the images."""
    order = None if files.preop is None else phase_order(files.preop)
    if order is not None and (seen is None or not seen.delay.suspicious):
        yield finding(Disagreement.CINE_ORDER_UNUSUAL, _key_of_heart(files), order=order)
    if seen is None:
        return
    delay = seen.delay
    which = "late" if delay.delay_s > 0 else "early"
    ms = 1e3 * abs(delay.delay_s)
    sign = isinstance(files.latency, float) and delay.suspicious and _is_sign(delay, files.latency)
    if isinstance(files.latency, float) and not sign and seen.reversed_latency > REVERSED_LOG_RATIO:
        yield finding(Disagreement.LATENCY_SIGN_UNLIKELY, "calibration.latency", ms=1e3 * files.latency)
    if seen.own is not None and seen.contradicted:
        if seen.stretch is not None:
            wrong = "short" if seen.stretch > 1.0 else "long"
            yield finding(Disagreement.ECG_CLOCK_WRONG, "ecg", share=abs(seen.stretch - 1.0), which=wrong)
        else:
            yield finding(Disagreement.ECG_OF_ANOTHER_RECORDING, "ecg", bpm=60.0 / seen.own.rr_s)
        return
    if delay.suspicious and order is not None:
        yield finding(Disagreement.CINE_ORDER, _key_of_heart(files), order=order, ms=ms, which=which)
        return
    if sign:
        yield finding(Disagreement.LATENCY_SIGN, "calibration.latency", ms=ms)
    elif delay.suspicious:
        cause = Disagreement.ECG_LATE if delay.certain else Disagreement.ECG_PERHAPS_LATE
        yield finding(cause, "ecg", ms=ms, which=which)
    if seen.drift_s is not None and abs(seen.drift_s) > LATE_S:
        yield finding(Disagreement.ECG_DRIFTS, "ecg", ms=1e3 * abs(seen.drift_s))


def _is_sign(delay: EcgDelay, lag_s: float) -> bool:
    """Whether a latency of the other sign explains the delay."""
    return abs(delay.delay_s + 2.0 * lag_s) < SAME_S < abs(lag_s)


def _key_of_heart(files: SessionFiles) -> str:
    return "preop.model" if files.model is not None else "preop.labels"


def phase_order(heart: PreopFiles) -> str | None:
    """Say what is unusual in the order of the phases by the volume of blood; None if it is as in a heart.

    From the R peak on a heart empties, for less than half of the cycle, and fills again.
    """
    model = heart.model
    if model is None or not model.chambers:
        return None
    volumes = np.array([mesh.volume_mm3() for mesh in model.chambers[0].surfaces])
    fractions, swing = model.timing.fractions, float(np.ptp(volumes))
    if swing < LEAST_SWING * volumes.max():
        return None
    largest, smallest = (float(fractions[i]) for i in (volumes.argmax(), volumes.argmin()))
    travel = float(np.abs(np.diff(volumes, append=volumes[0])).sum())
    if travel > MOST_TRAVEL * swing:
        return f"the volume of blood goes up and down {travel / (2.0 * swing):.1f} times a cycle"
    if min(largest, 1.0 - largest) > LATEST_LARGEST:
        return f"the heart is fullest at {largest:.0%} of the cycle, not near the R peak"
    if (smallest - largest) % 1.0 > LONGEST_EMPTYING:
        return f"the heart takes {(smallest - largest) % 1.0:.0%} of the cycle to empty"
    return None


def mr_order_finding(heart: PreopFiles) -> Finding | None:
    """Find grey levels whose phases are in another order than the model's, by when each moves most."""
    mr, model, speed = heart.preop.mr, heart.model, heart_speed(heart)
    if mr is None or model is None or speed is None or len(mr.timing) < FEWEST_PHASES:
        return None
    corners = np.concatenate([mesh.vertices_mm for mesh in model.reference])
    index = mr.grid.to_index(np.array([corners.min(axis=0), corners.max(axis=0)]))
    low, high = np.sort(index, axis=0)
    box = tuple(
        slice(max(0, int(a)), max(1, int(np.ceil(b))), max(1, int((b - a) / MOST_SIDE)))
        for a, b in zip(low, high, strict=True)
    )
    values = mr.values[(slice(None), *box)].astype(np.float64)
    changes = np.abs(np.roll(values, -1, axis=0) - values).mean(axis=(1, 2, 3))
    seen = speed_between(changes, mr.timing.fractions)
    cycle = np.arange(SHIFTS) / SHIFTS
    moves, changed = speed.at(cycle), seen.at(cycle)
    fits = [float(np.corrcoef(moves, np.roll(changed, -k))[0, 1]) for k in range(SHIFTS)]
    best = int(np.argmax(fits))
    shift = (best / SHIFTS + 0.5) % 1.0 - 0.5
    if fits[best] < FITS or fits[best] - fits[0] < FITS_BETTER:
        return None
    which = "later" if shift > 0 else "earlier"
    return finding(Disagreement.MR_OF_OTHER_ORDER, "preop.mr", share=abs(shift), which=which)


LEAST_LAG_S = 0.02
"""Latency below which its sign hardly matters: a probe at 30 mm/s moves by 1.2 mm in twice this time."""
REVERSED_LOG_RATIO = 3.0
"""Log-likelihood ratio of the other sign from which it is named; right ones of 25 to 70 ms have −5 to −14."""


def reversed_log_ratio(
    images: ImageChange, probe: PoseStream, image: ImageMap, shape: tuple[int, ...], lag_s: float
) -> float:
    """Log-likelihood ratio of −lag_s against lag_s by the probe's motion; 0 if it cannot be judged.

    Args:
        probe: tracker_from_probe.
        image: probe_from_image.
        shape: (rows, columns).
        lag_s: t_tracker = t_video + lag_s.
    """
    if abs(lag_s) < LEAST_LAG_S or not len(images.t_s):
        return 0.0
    points_mm = grid_mm(image, shape)
    moved_mm, seen = _moved_mm(images, probe, points_mm, lag_s)
    other, seen_other = _moved_mm(images, probe, points_mm, -lag_s)
    inside = seen & seen_other
    if (count := int(np.count_nonzero(inside))) < LEAST_PAIRS:
        return 0.0
    change = np.log(images.change[inside])
    left = [residual_of_fit(without_heart(moved[inside]), change)[0] for moved in (moved_mm, other)]
    return float(0.25 * count * np.log(left[0] / left[1]))


def _moved_mm(
    images: ImageChange, probe: PoseStream, points_mm: FloatArray, lag_s: float
) -> tuple[FloatArray, BoolArray]:
    """(n,) mean distance by which the probe moved points between two frames, and whether it was tracked."""
    ends = [probe.at_many(images.t_s + lag_s + part * images.step_s) for part in (-0.5, 0.5)]
    (turns, shifts_mm, seen), (turns_after, shifts_after_mm, seen_after) = ends
    return moved_between_mm(turns_after - turns, shifts_after_mm - shifts_mm, points_mm), seen & seen_after
