"""Pivot calibration: the position of a tool's tip, from poses recorded while the tip rested in a divot."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from dvf_ig.calibration.inliers import MIN_INLIERS, InlierRule, fit_inliers
from dvf_ig.calibration.refusal import Gate, Refusal
from dvf_ig.core import (
    BoolArray,
    FloatArray,
    InvalidInputError,
    Points,
    PoseStream,
    QualityGateError,
    read_only_arrays,
)

MAX_CONDITION = 1e6
"""Condition number above which the poses determine no tip at all."""


CONSENSUS_MM = 2.0
"""3-D residual within which a pose supports a hypothesis."""
HYPOTHESES = 500
"""Three-pose samples drawn."""
KEEP_SIGMA = 5.0
"""Poses within this many robust standard deviations are inliers."""
MIN_SPAN_DEG = 15.0
"""Smallest accepted largest pairwise rotation."""
MIN_INLIER_SHARE = 0.5
"""Smallest accepted share of poses that agree."""


@dataclass(frozen=True, slots=True)
class PivotOptions:
    """Options of the pivot fit and limits of its quality gates (docs/theory/calibration.md).

    Attributes:
        max_condition: largest accepted condition number of the linear system.
        max_rms_mm: largest accepted 3-D RMS of the inliers.
    """

    max_condition: float = 60.0
    max_rms_mm: float = 2.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PivotResult:
    """A tool tip with its evidence.

    Attributes:
        tip: one point in the stream's source frame.
        pivot: one point in its target frame: the divot.
        rms_3d_mm: root mean square length of the inliers' residuals.
        rms_per_coordinate_mm: rms_3d_mm / √3, what some packages report.
        inliers: (n,) poses that took part; False for invalid samples.
        residuals_mm: (n,) length of each pose's residual, outliers included; NaN for invalid samples.
        poses: valid poses given.
        span_deg: largest rotation between two inliers.
        condition: condition number of the inliers' linear system.
        covariance: (6, 6) mm² of (tip, pivot), from the residuals.
        refusals: the gates that the estimate failed; it must not be used unless there are none.
    """

    tip: Points
    pivot: Points
    rms_3d_mm: float
    rms_per_coordinate_mm: float
    inliers: BoolArray
    residuals_mm: FloatArray
    poses: int
    span_deg: float
    condition: float
    covariance: FloatArray
    refusals: tuple[Refusal, ...] = ()


def calibrate_pivot(poses: PoseStream, *, rng: Generator, options: PivotOptions | None = None) -> PivotResult:
    """Fit tip and pivot point by least squares on the poses that agree with one pivot.

    Args:
        poses: target_from_source of the tool, mm; samples that are not valid are left out.
        rng: draws the three-pose samples; the refit makes the result all but independent of it.
        options: see PivotOptions.
    Raises:
        InvalidInputError: fewer than 3 valid poses.
        QualityGateError: no tip can be computed: the tool did not turn, or turned about one axis, or no
            three poses agree. An estimate that fails a gate (small rotations, few poses that agree,
            a large residual) carries its refusals.
    Source: Yaniv 2015 (algebraic one step: [R_i −I][tip; pivot] = −t_i); MSAC of Torr & Zisserman 2000.
    """
    options = options or PivotOptions()
    valid = np.flatnonzero(poses.valid)
    if len(valid) < 3:
        raise InvalidInputError(
            f"{poses.name} has {len(valid)} valid poses of {len(poses)}; pivot calibration needs at least 3: "
            "record again with the tool in view"
        )
    rotations, translations = poses.rotations[valid], poses.translations_mm[valid]
    keep = _inliers(rotations, translations, rng)
    if keep.sum() < MIN_INLIERS:
        raise QualityGateError(_few_agree(poses.name, keep))
    return _result(poses, valid, keep, options)


def rotation_span_deg(rotations: FloatArray) -> float:
    """Compute the largest rotation angle between any two of (n, 3, 3) rotations."""
    quaternions = Rotation.from_matrix(rotations).as_quat()
    smallest = 1.0
    for start in range(0, len(quaternions), 512):
        smallest = min(smallest, float(np.abs(quaternions[start : start + 512] @ quaternions.T).min()))
    return float(np.degrees(2.0 * np.arccos(min(1.0, smallest))))


def _result(
    poses: PoseStream,
    valid: np.ndarray[tuple[int], np.dtype[np.intp]],
    keep: BoolArray,
    options: PivotOptions,
) -> PivotResult:
    rotations, translations = poses.rotations[valid][keep], poses.translations_mm[valid][keep]
    span = rotation_span_deg(rotations)
    matrix = _system(rotations)
    condition = float(np.linalg.cond(matrix))
    if not condition <= MAX_CONDITION:
        limit = replace(options, max_condition=min(options.max_condition, MAX_CONDITION))
        raise QualityGateError(_rotation_refusals(poses.name, span, condition, limit)[0].detail)
    solution = _solve(rotations, translations)
    lengths = _residual_lengths(solution[None], rotations, translations)[0]
    rms = float(np.sqrt(np.mean(lengths**2)))
    variance = float((lengths**2).sum()) / max(1, 3 * len(lengths) - 6)
    inliers = np.zeros(len(poses), dtype=np.bool_)
    inliers[valid[keep]] = True
    residuals = np.full(len(poses), np.nan)
    residuals[valid] = _residual_lengths(
        solution[None], poses.rotations[valid], poses.translations_mm[valid]
    )[0]
    return PivotResult(
        tip=Points(poses.source, solution[None, :3]),
        pivot=Points(poses.target, solution[None, 3:]),
        rms_3d_mm=rms,
        rms_per_coordinate_mm=rms / np.sqrt(3.0),
        inliers=inliers,
        residuals_mm=residuals,
        poses=len(valid),
        span_deg=span,
        condition=condition,
        covariance=np.asarray(variance * np.linalg.inv(matrix.T @ matrix), dtype=np.float64),
        refusals=(
            *_rotation_refusals(poses.name, span, condition, options),
            *_agreement_refusals(poses.name, keep, rms, options),
        ),
    )


def _inliers(rotations: FloatArray, translations: FloatArray, rng: Generator) -> BoolArray:
    """Select (n,) inliers, starting from the best-supported pivot of random three-pose samples."""
    best = _best_hypothesis(rotations, translations, rng)
    return fit_inliers(
        lambda keep, _: _solve(rotations[keep], translations[keep]),
        lambda solution: [_residual_lengths(solution[None], rotations, translations)[0]],
        _residual_lengths(best[None], rotations, translations)[0] <= CONSENSUS_MM,
        InlierRule(KEEP_SIGMA, scale_below=2 * CONSENSUS_MM),
    ).inliers


def _best_hypothesis(rotations: FloatArray, translations: FloatArray, rng: Generator) -> FloatArray:
    """(6,) tip and pivot with the smallest truncated squared residual over random three-pose fits."""
    n = len(rotations)
    triples = (
        rng.permuted(np.tile(np.arange(n), (HYPOTHESES, 1)), axis=1)[:, :3]
        if n > 3
        else (np.array([[0, 1, 2]]))
    )
    systems = np.stack([_system(rotations[t]) for t in triples])
    right = -translations[triples].reshape(len(triples), 9)
    candidates = np.einsum("kij,kj->ki", np.linalg.pinv(systems), right)
    lengths = _residual_lengths(candidates, rotations, translations)
    cost = np.minimum(lengths, CONSENSUS_MM) ** 2
    return np.asarray(candidates[int(cost.sum(axis=1).argmin())])


def _system(rotations: FloatArray) -> FloatArray:
    """(3n, 6) rows [R_i  −I]."""
    n = len(rotations)
    return np.concatenate([rotations, np.tile(-np.eye(3), (n, 1, 1))], axis=2).reshape(3 * n, 6)


def _solve(rotations: FloatArray, translations: FloatArray) -> FloatArray:
    """(6,) least-squares tip and pivot."""
    return np.asarray(np.linalg.lstsq(_system(rotations), -translations.ravel(), rcond=None)[0])


def _residual_lengths(solutions: FloatArray, rotations: FloatArray, translations: FloatArray) -> FloatArray:
    """(k, n) |R_i tip + t_i − pivot| for (k, 6) solutions."""
    tips = np.einsum("nij,kj->kni", rotations, solutions[:, :3])
    return np.asarray(np.linalg.norm(tips + translations - solutions[:, None, 3:], axis=2))


def _rotation_refusals(
    name: str, span_deg: float, condition: float, options: PivotOptions
) -> tuple[Refusal, ...]:
    advice = "tilt the tool in all directions about the divot"
    if span_deg < MIN_SPAN_DEG:
        detail = f"{name} rotates by {span_deg:.1f}° only, needed at least {MIN_SPAN_DEG:g}°; {advice}"
        return (Refusal(Gate.SMALL_ROTATION, f"{detail} while recording"),)
    if condition > options.max_condition:
        detail = f"condition number {condition:.0f}, needed at most {options.max_condition:g}"
        return (Refusal(Gate.ONE_AXIS, f"{name} rotates about one axis only ({detail}); {advice}"),)
    return ()


def _agreement_refusals(
    name: str, keep: BoolArray, rms_mm: float, options: PivotOptions
) -> tuple[Refusal, ...]:
    refusals = []
    if keep.mean() < MIN_INLIER_SHARE:
        refusals.append(Refusal(Gate.FEW_AGREE, _few_agree(name, keep)))
    if rms_mm > options.max_rms_mm:
        detail = (
            f"pivot residual of {name} is {rms_mm:.2f} mm RMS, above the gate of {options.max_rms_mm:g} mm "
            "(--max-residual-mm moves it); keep the tip in the divot and check that the marker is tight"
        )
        refusals.append(Refusal(Gate.RESIDUAL, detail))
    return tuple(refusals)


def _few_agree(name: str, keep: BoolArray) -> str:
    return (
        f"only {int(keep.sum())} of {len(keep)} poses of {name} rotate about one point within "
        f"{CONSENSUS_MM:g} mm; needed {MIN_INLIER_SHARE:.0%}: keep the tip in the divot"
    )
