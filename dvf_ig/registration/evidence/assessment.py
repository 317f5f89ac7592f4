"""From evidence to a probability and a bound in mm, by tables that were fitted on hearts with a known truth.

    x_j    the checks and the predicted error, as logarithms, so turned that larger is worse, cut where the
           calibration had nothing; a check that could not be made counts as one that only just passed
    μ      w₀ + Σ w_j x_j, all w_j >= 0: predicted logarithm of the largest target error
    P      of a mean error below 2 mm: isotonic regression on μ
    bound  exp(μ + q), q the split-conformal 95 % quantile of log(largest error) − μ, one heart one trial; of
           a heart that its images cover in part that of its scaled covariance (`registration.register`)
    scale  exp(v₀ + Σ v_j x_j): of the covariance, whose 90 % region then holds the truth in 90 % of hearts

P and bound are cross-fitted by heart (`study.hearts.fit`). For images whose statistics lie outside all that
was calibrated neither is stated.
Sources: Barlow 1972 (isotonic regression); Lei et al. 2018 (split conformal prediction, normalised).
"""

import json
import math
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.registration.lc2.slices import SliceSet

from .checks import Evidence

SUCCESS_MM = 2.0
"""A pose whose mean target error is below this is a success."""
FEATURES = (
    "z_score",
    "split_half_mm",
    "phase_mm",
    "half_volume_mm",
    "boundary_mm",
    "phase_offset_ratio",
    "unexplained",
    "predicted_mm",
    "not_imaged",
)
"""In the order of a table's weights; each is the worse the larger it is: of the z-score its inverse,
"unexplained" is 1 − LC2, and "not_imaged" the share of the covered part of a heart that no slice shows."""
LARGEST = 1e3
"""Values of a feature count as no more than this, and as no less than its inverse."""
LARGEST_SCALE = 16.0
"""The covariance is multiplied by no more than this, and by no less than its inverse."""
TABLES = "calibrated.json"
OF_STACK, OF_STACK_AND_VIEWS = "-of-sax", "-of-sax+lax"
"""Endings of the kind of images of hearts that the pre-operative images cover in part: short-axis slices
alone, or with long-axis views."""
NAMES = {
    "brightness": "the images' mean brightness",
    "contrast": "the images' contrast",
    "structure": "how smooth the images are",
    "fill": "how much of the sector is lit",
    "slices": "the number of slices",
    "view_spread_deg": "the spread of the views (°)",
    "extent_mm": "the extent of the sweep (mm)",
    "similarity": "LC2",
    "overlap": "the overlap with the model",
    "information": "the amount of ultrasound",
}
OF_ULTRASOUND = ("brightness", "contrast", "structure", "fill", "slices", "view_spread_deg", "extent_mm")
"""Statistics that do not depend on the heart's images: all hearts calibrated with such ultrasound count."""


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
        """Statistics by name."""
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


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Calibration of the evidence for one kind of images.

    Attributes:
        hearts: that it was fitted on.
        intercept, weights: w₀ and (f,) w_j >= 0.
        low, high: (f,) limits between which a feature counts.
        missing: (f,) what a check counts as that could not be made.
        predicted: (k,) increasing μ; probability: (k,) decreasing P there, linear between them.
        refused_probability: share of successes among poses that a check refused.
        bound_quantile: q; inf if there were too few hearts for one, or the covariance bounds the error.
        largest: μ above which a pose must not guide.
        scale_intercept, scale_weights: v₀ and (f,) v_j of the covariance's scale.
        ranges: lowest and highest value of each image statistic.
        outside_p: at most this share of hearts like those calibrated lie outside of the ranges.
    """

    hearts: int
    intercept: float
    weights: FloatArray
    low: FloatArray
    high: FloatArray
    missing: FloatArray
    predicted: FloatArray
    probability: FloatArray
    refused_probability: float
    bound_quantile: float
    largest: float
    scale_intercept: float
    scale_weights: FloatArray
    ranges: dict[str, tuple[float, float]]
    outside_p: float


@dataclass(frozen=True, slots=True)
class Assessment:
    """Statement on a pose's error.

    Attributes:
        success_probability: chance that the mean error over the targets is below SUCCESS_MM; None if the
            images are unlike all that was calibrated, or nothing was calibrated for their kind.
        tre_bound_mm: the largest error over the heart-box targets is below this in 95 of 100 hearts; None as
            above, and of a refused pose.
        outside: why neither can be stated, as a user reads it; empty otherwise.
        doubtful: whether the evidence is worse than that of nearly all good poses.
        covariance_scale: by which the covariance is to be multiplied.
    """

    success_probability: float | None
    tre_bound_mm: float | None
    outside: str = ""
    doubtful: bool = False
    covariance_scale: float = 1.0


def features_of(
    evidence: Evidence, similarity: float, predicted_mm: float, imaged: float | None
) -> dict[str, float | None]:
    """Features by name; None if the check could not be made.

    Args:
        similarity: LC2 at the pose.
        predicted_mm: RMS target error that the covariance predicts.
        imaged: share of the covered part of a heart that the slices show; None of a heart that is covered.
    """
    offset = evidence.phase_offset
    return {
        "z_score": 1.0 / max(evidence.z_score, 1e-3),
        "split_half_mm": evidence.split_half_mm,
        "phase_mm": evidence.phase_mm,
        "half_volume_mm": evidence.half_volume_mm,
        "boundary_mm": evidence.boundary_mm,
        "phase_offset_ratio": None if offset is None else 1.0 + offset.log_likelihood_ratio,
        "unexplained": 1.0 - similarity,
        "predicted_mm": predicted_mm,
        "not_imaged": None if imaged is None else 1.0 - imaged,
    }


def logarithms(features: dict[str, float | None]) -> FloatArray:
    """(f,) x_j in the order of FEATURES, NaN where a check could not be made."""
    return np.array([_logarithm(features[name]) for name in FEATURES])


def _logarithm(value: float | None) -> float:
    if value is None:
        return math.nan
    return math.log(min(max(value, 1.0 / LARGEST), LARGEST)) if not math.isnan(value) else math.log(LARGEST)


def counted(table: Table, logs: FloatArray) -> FloatArray:
    """(f,) x_j as they count: cut at the limits, the missing filled in."""
    return np.clip(np.where(np.isnan(logs), table.missing, logs), table.low, table.high)


def assess(table: Table | None, features: dict[str, float | None], statistics: ImageStatistics) -> Assessment:
    """State the error to expect of a pose that no check refused.

    Args:
        table: of the images' kind; None if nothing was calibrated for it.
    """
    if table is None:
        return Assessment(None, None, "no probability was calibrated for images of this kind")
    x = counted(table, logarithms(features))
    error = float(table.intercept + table.weights @ x)
    scale = covariance_scale(table, x)
    strange = _outside(table, statistics)
    doubtful = error > table.largest
    if strange:
        return Assessment(None, None, strange, doubtful, max(1.0, scale))
    bound = math.exp(error + table.bound_quantile) if math.isfinite(table.bound_quantile) else None
    return Assessment(
        float(np.interp(error, table.predicted, table.probability)),
        bound,
        doubtful=doubtful,
        covariance_scale=scale,
    )


def covariance_scale(table: Table, x: FloatArray) -> float:
    """Scale of a covariance whose features count as (f,) x."""
    logarithm = float(table.scale_intercept + table.scale_weights @ x)
    return min(max(math.exp(logarithm), 1.0 / LARGEST_SCALE), LARGEST_SCALE)


def _outside(table: Table, statistics: ImageStatistics) -> str:
    """Names the statistic that lies furthest outside its range; empty where all lie within."""
    worst, sentence = 0.0, ""
    for name, value in statistics.values().items():
        low, high = table.ranges[name]
        beyond = max(low - value, value - high) / max(high - low, 1e-12)
        if beyond > worst:
            worst = beyond
            sentence = (
                f"outside what was calibrated: {NAMES[name]} is {value:.3g}, where calibrated it was "
                f"{low:.3g} to {high:.3g}"
            )
    return sentence


def table_of(kind: str | None, covered: str = "") -> Table | None:
    """The table of a kind of images ("sweep", "volumes", …); None without one.

    Args:
        covered: ending of the kind where the heart's images cover it in part, for which whole hearts say
            nothing, but of what ultrasound looks like; see OF_STACK and OF_ULTRASOUND.
    """
    table, whole = _tables().get(f"{kind}{covered}"), _tables().get(str(kind))
    if table is None or whole is None:
        return table
    return replace(table, ranges=table.ranges | {name: _united(table, whole, name) for name in OF_ULTRASOUND})


def _united(table: Table, other: Table, name: str) -> tuple[float, float]:
    (low, high), (other_low, other_high) = table.ranges[name], other.ranges[name]
    return min(low, other_low), max(high, other_high)


@lru_cache(maxsize=1)
def _tables() -> dict[str, Table]:
    text = resources.files(__package__).joinpath(TABLES).read_text(encoding="utf-8")
    return {kind: table_from_json(table) for kind, table in json.loads(text)["kinds"].items()}


def table_from_json(held: dict[str, Any]) -> Table:
    """A table from its JSON: arrays as lists, an infinite quantile as null."""
    quantile = held["bound_quantile"]
    return Table(
        hearts=held["hearts"],
        intercept=held["intercept"],
        weights=np.array(held["weights"]),
        low=np.array(held["low"]),
        high=np.array(held["high"]),
        missing=np.array(held["missing"]),
        predicted=np.array(held["predicted"]),
        probability=np.array(held["probability"]),
        refused_probability=held["refused_probability"],
        bound_quantile=math.inf if quantile is None else quantile,
        largest=held["largest"],
        scale_intercept=held["scale_intercept"],
        scale_weights=np.array(held["scale_weights"]),
        ranges={name: (low, high) for name, (low, high) in held["ranges"].items()},
        outside_p=held["outside_p"],
    )
