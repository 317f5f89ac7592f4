"""Hand–eye calibration: where a camera sits on the hand, robot flange or probe that holds it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.random import Generator
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dvf_ig.calibration.inliers import MIN_INLIERS, Consensus, InlierRule, fit_inliers
from dvf_ig.calibration.pivot.pivot import rotation_span_deg
from dvf_ig.calibration.refusal import Gate, Refusal
from dvf_ig.core import (
    BoolArray,
    FloatArray,
    InvalidInputError,
    NoOverlapError,
    PoseStream,
    QualityGateError,
    Rigid,
    read_only_arrays,
)
from dvf_ig.core.space.rigid import nearest_rotation


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Paired poses: base_from_hand and camera_from_target, (n, 3, 3) and (n, 3) mm each."""

    hand_rotations: FloatArray
    hand_translations: FloatArray
    target_rotations: FloatArray
    target_translations: FloatArray

    def __len__(self) -> int:
        return len(self.hand_rotations)

    def part(self, keep: Any) -> "Chain":
        """Select pairs by a mask or by indices."""
        return Chain(
            self.hand_rotations[keep],
            self.hand_translations[keep],
            self.target_rotations[keep],
            self.target_translations[keep],
        )

    def axis_spread(self) -> float:
        """Ratio of second to first principal size of the hand's rotation vectors between pairs of poses."""
        first, second = np.triu_indices(len(self), 1)
        step = max(1, len(first) // 2000)
        first, second = first[::step], second[::step]
        between = np.einsum("nji,njk->nik", self.hand_rotations[first], self.hand_rotations[second])
        sizes = np.linalg.svd(Rotation.from_matrix(between).as_rotvec(), compute_uv=False)
        return float(sizes[1] / sizes[0]) if len(sizes) > 1 and sizes[0] > 0 else 0.0

    def targets(self, hand_from_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute base_from_target through each pair: (n, 3, 3) and (n, 3) mm."""
        to_hand = hand_from_camera[:3, :3] @ self.target_rotations
        in_hand = self.target_translations @ hand_from_camera[:3, :3].T + hand_from_camera[:3, 3]
        moved = np.einsum("nij,nj->ni", self.hand_rotations, in_hand) + self.hand_translations
        return self.hand_rotations @ to_hand, moved

    def middle_target(self, hand_from_camera: FloatArray) -> FloatArray:
        """Return base_from_target (4, 4) of the pair whose target is nearest to all others."""
        rotations, translations = self.targets(hand_from_camera)
        center = np.median(translations, axis=0)
        away = np.linalg.norm(translations - center, axis=1)
        near = away <= np.median(away)
        out = np.eye(4)
        out[:3, :3] = Rotation.from_matrix(rotations[near]).mean().as_matrix()
        out[:3, 3] = center
        return out

    def residuals(
        self, hand_from_camera: FloatArray, base_from_target: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(n,) distance, mm, and angle, degrees, of each pair's target from base_from_target."""
        rotation, shift = self.errors(hand_from_camera, base_from_target)
        return np.linalg.norm(shift, axis=1), np.degrees(np.linalg.norm(rotation, axis=1))

    def errors(
        self, hand_from_camera: FloatArray, base_from_target: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(n, 3) rotation vectors, rad, and (n, 3) shifts, mm, of each pair's target, in its axes."""
        rotations, translations = self.targets(hand_from_camera)
        rotation = base_from_target[:3, :3].T @ rotations
        shift = (translations - base_from_target[:3, 3]) @ base_from_target[:3, :3]
        return Rotation.from_matrix(rotation).as_rotvec(), shift


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ChainFit:
    """(4, 4) hand_from_camera and base_from_target, and the (6, 6) covariance of the first (rad², mm²)."""

    hand_from_camera: FloatArray
    base_from_target: FloatArray
    covariance: FloatArray


def refine(chain: Chain, hand_from_camera: FloatArray) -> ChainFit:
    """Refine both unknown maps together by least squares on angles and shifts, each over its own spread.

    Source: Strobl & Hirzinger 2006 (the weight between rotation and translation from their residuals).
    """
    camera, target = hand_from_camera, chain.middle_target(hand_from_camera)
    for _ in range(2):
        errors = chain.errors(camera, target)
        scales = [max(float(np.sqrt((error**2).mean())), 1e-9) for error in errors]
        solved = least_squares(_stacked, np.zeros(12), args=(chain, camera, target, scales), x_scale="jac")
        camera, target = _moved(camera, solved.x[:6]), _moved(target, solved.x[6:])
    freedom = max(1, solved.fun.size - 12)
    slope = np.asarray(solved.jac, dtype=np.float64)
    inverse = np.linalg.pinv(slope.T @ slope)
    return ChainFit(camera, target, np.asarray(inverse[:6, :6] * (solved.fun @ solved.fun) / freedom))


def _stacked(
    step: FloatArray, chain: Chain, camera: FloatArray, target: FloatArray, scales: list[float]
) -> FloatArray:
    rotation, shift = chain.errors(_moved(camera, step[:6]), _moved(target, step[6:]))
    return np.concatenate([rotation.ravel() / scales[0], shift.ravel() / scales[1]])


def _moved(matrix: FloatArray, step: FloatArray) -> FloatArray:
    """(4, 4) after a rotation vector (rad) on the left of its rotation and a shift (mm)."""
    out = matrix.copy()
    out[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix() @ matrix[:3, :3]
    out[:3, 3] = matrix[:3, 3] + step[3:]
    return out


HandEyeMethod = Literal["tsai", "park", "horaud", "andreff", "daniilidis", "shah", "li"]
HAND_EYE_METHODS: tuple[HandEyeMethod, ...] = get_args(HandEyeMethod)

_ROBOT_WORLD = ("shah", "li")


def closed_form(method: HandEyeMethod) -> Callable[[Chain], FloatArray]:
    """Return the function from a chain to (4, 4) hand_from_camera; it gives NaN if OpenCV finds none."""
    if method not in HAND_EYE_METHODS:
        raise InvalidInputError(f"hand-eye method '{method}' is not one of {', '.join(HAND_EYE_METHODS)}")

    def solve(chain: Chain) -> FloatArray:
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = _opencv(chain, method)
        if not np.isfinite(out).all() or np.linalg.det(out[:3, :3]) <= 0:
            return np.full((4, 4), np.nan)
        out[:3, :3] = nearest_rotation(out[:3, :3])
        return out

    return solve


def _opencv(chain: Chain, method: HandEyeMethod) -> tuple[FloatArray, FloatArray]:
    """Compute rotation and translation of hand_from_camera; NaN if OpenCV refuses a degenerate sample."""
    import cv2

    hand = (list(chain.hand_rotations), list(chain.hand_translations))
    target = (list(chain.target_rotations), list(chain.target_translations))
    try:
        if method not in _ROBOT_WORLD:
            kind = getattr(cv2, f"CALIB_HAND_EYE_{method.upper()}")
            rotation, shift = cv2.calibrateHandEye(*hand, *target, method=kind)
            return np.asarray(rotation), np.ravel(shift)
        inverse = np.swapaxes(chain.hand_rotations, 1, 2)
        shifted = -np.einsum("nij,nj->ni", inverse, chain.hand_translations)
        kind = getattr(cv2, f"CALIB_ROBOT_WORLD_HAND_EYE_{method.upper()}")
        solution = cv2.calibrateRobotWorldHandEye(*target, list(inverse), list(shifted), method=kind)
    except cv2.error:
        return np.full((3, 3), np.nan), np.full(3, np.nan)
    hand_from_camera = np.asarray(solution[2]).T
    return hand_from_camera, -hand_from_camera @ np.ravel(solution[3])


_NO_ROTATION_DEG, _NO_SPREAD = 1.0, 1e-3
"""Rotation (degrees) and spread of its axes below which the hand's motion determines no map at all."""
_SAMPLE = 4
"""Poses of one hypothesis: three determine the answer, a fourth steadies it."""


CONSENSUS_MM = 3.0
CONSENSUS_DEG = 2.0
"""A pose supports a hypothesis that places the target within both."""
HYPOTHESES = 100
"""Four-pose samples drawn."""
KEEP_SIGMA = 4.0
"""Pairs within this many robust standard deviations are inliers."""
MIN_SPAN_DEG = 15.0
"""Smallest accepted largest rotation between two poses of the hand."""
MIN_AXIS_SPREAD = 0.1
"""Smallest accepted ratio of the second to the first principal size of the hand's rotation vectors; 0 if
all rotations are about one axis, which does not determine the shift along it."""
MIN_INLIER_SHARE = 0.5
"""Smallest accepted share of pairs that agree."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class HandEyeResult:
    """Pose of a camera on the hand, with its evidence.

    Attributes:
        hand_from_camera: the map.
        base_from_target: pose of the target in the base.
        t_s: (n,) times of the pairs, the camera's clock.
        residuals_mm, residuals_deg: (n,) distance and angle of the target, seen through each pair, from
            base_from_target.
        rms_mm, rms_deg: root mean squares over the inliers.
        inliers: (n,) pairs that took part.
        span_deg: largest rotation between two inlier poses of the hand.
        axis_spread: see MIN_AXIS_SPREAD.
        covariance: (6, 6) rad², mm² of hand_from_camera (rotation in the hand's axes first).
        refusals: the gates that the estimate failed; it must not be used unless there are none.
    """

    hand_from_camera: Rigid
    base_from_target: Rigid
    t_s: FloatArray
    residuals_mm: FloatArray
    residuals_deg: FloatArray
    rms_mm: float
    rms_deg: float
    inliers: BoolArray
    span_deg: float
    axis_spread: float
    covariance: FloatArray
    refusals: tuple[Refusal, ...] = ()


def calibrate_hand_eye(
    base_from_hand: PoseStream,
    camera_from_target: PoseStream,
    *,
    rng: Generator,
    method: HandEyeMethod = "park",
) -> HandEyeResult:
    """Fit hand_from_camera so that base_from_hand · hand_from_camera · camera_from_target stays constant.

    The hand's pose is interpolated at the camera's times; samples that are not valid, and times between hand
    samples that are not, are left out. A closed form on four-pose samples is judged by its consensus, then
    all pairs that agree are fitted together.

    Args:
        base_from_hand: the hand or robot flange in its base, mm.
        camera_from_target: a target that does not move, as the camera sees it, mm.
        rng: draws the samples; the last fit makes the result all but independent of it.
        method: the closed form that starts the fit: tsai, park, horaud, andreff, daniilidis (hand–eye), or
            shah, li (robot–world and hand–eye together).
    Raises:
        InvalidInputError: frames that repeat, or fewer than 3 pairs.
        NoOverlapError: the two streams share no time.
        QualityGateError: no map can be computed: the hand stood still, turned about one axis, or hardly a
            pair agrees. What is computed but fails a gate carries its refusals.
    Source: Tsai & Lenz 1989, Park & Martin 1994, Shah 2013 (in OpenCV); MSAC of Torr & Zisserman 2000.
    """
    chain, t_s = _paired(base_from_hand, camera_from_target)
    _refuse_undetermined(chain, base_from_hand.name)
    agreed = _inliers(chain, closed_form(method), rng)
    keep, fitted = agreed.inliers, agreed.model
    refusals = _few_agree(keep, camera_from_target.target)
    if keep.sum() < MIN_INLIERS:
        raise QualityGateError(refusals[0].detail)
    turned = _rotation_refusals(chain.part(keep), base_from_hand.name)
    if fitted is None:
        raise QualityGateError(
            f"method '{method}' gives no pose of '{camera_from_target.target}' from the "
            f"{int(keep.sum())} pairs that agree; try another method"
        )
    mm, degrees = chain.residuals(fitted.hand_from_camera, fitted.base_from_target)
    return HandEyeResult(
        hand_from_camera=Rigid.from_matrix(
            fitted.hand_from_camera, base_from_hand.source, camera_from_target.target
        ),
        base_from_target=Rigid.from_matrix(
            fitted.base_from_target, base_from_hand.target, camera_from_target.source
        ),
        t_s=t_s,
        residuals_mm=mm,
        residuals_deg=degrees,
        rms_mm=float(np.sqrt((mm[keep] ** 2).mean())),
        rms_deg=float(np.sqrt((degrees[keep] ** 2).mean())),
        inliers=keep,
        span_deg=rotation_span_deg(chain.part(keep).hand_rotations),
        axis_spread=chain.part(keep).axis_spread(),
        covariance=fitted.covariance,
        refusals=(*turned, *refusals),
    )


def _paired(hand: PoseStream, camera: PoseStream) -> tuple[Chain, FloatArray]:
    frames = [hand.target, hand.source, camera.target, camera.source]
    if len(set(frames)) < 4:
        raise InvalidInputError(
            f"{hand.name} and {camera.name} share a frame; needed four: base, hand, camera and target"
        )
    seen = camera.t_s[camera.valid]
    rotations, translations, ok = hand.at_many(seen)
    if not ok.any():
        raise NoOverlapError(
            f"no sample of {camera.name} ({camera.t_s[0]:.2f} to {camera.t_s[-1]:.2f} s) lies between valid "
            f"samples of {hand.name} ({hand.t_s[0]:.2f} to {hand.t_s[-1]:.2f} s); record both on one clock"
        )
    if ok.sum() < 3:
        raise InvalidInputError(
            f"{hand.name} and {camera.name} have {int(ok.sum())} pairs of valid poses; needed at least 3, "
            "and 20 or more in all directions for a good result"
        )
    return (
        Chain(
            rotations[ok],
            translations[ok],
            camera.rotations[camera.valid][ok],
            camera.translations_mm[camera.valid][ok],
        ),
        seen[ok],
    )


def _few_agree(keep: BoolArray, camera: str) -> tuple[Refusal, ...]:
    if keep.sum() >= max(MIN_INLIERS, MIN_INLIER_SHARE * len(keep)):
        return ()
    detail = (
        f"only {int(keep.sum())} of {len(keep)} pairs agree on one pose of '{camera}' "
        f"within {CONSENSUS_MM:g} mm and {CONSENSUS_DEG:g}°, needed "
        f"{MIN_INLIER_SHARE:.0%}; check that the target stood still and that both clocks are one"
    )
    return (Refusal(Gate.FEW_AGREE, detail),)


def _refuse_undetermined(chain: Chain, name: str) -> None:
    """Raise if the hand's motion does not determine the camera's pose at all."""
    if rotation_span_deg(chain.hand_rotations) < _NO_ROTATION_DEG or chain.axis_spread() < _NO_SPREAD:
        raise QualityGateError(_rotation_refusals(chain, name)[0].detail)


def _rotation_refusals(chain: Chain, name: str) -> tuple[Refusal, ...]:
    span, spread = rotation_span_deg(chain.hand_rotations), chain.axis_spread()
    if span < MIN_SPAN_DEG:
        detail = (
            f"{name} rotates by {span:.1f}° only, needed at least {MIN_SPAN_DEG:g}°; tilt the hand "
            "in all directions while the camera sees the target"
        )
        return (Refusal(Gate.SMALL_ROTATION, detail),)
    if spread < MIN_AXIS_SPREAD:
        detail = (
            f"{name} rotates about one axis only (spread of the axes {spread:.3f}, needed at least "
            f"{MIN_AXIS_SPREAD:g}); its position along it stays unknown: rotate about a second "
            "axis too"
        )
        return (Refusal(Gate.ONE_AXIS, detail),)
    return ()


def _inliers(chain: Chain, solve: Callable[[Chain], FloatArray], rng: Generator) -> Consensus[ChainFit]:
    """Select inliers, starting from the best-supported closed form of random samples."""
    best, lowest = np.ones(len(chain), dtype=np.bool_), np.inf
    # accept a smaller spread if the whole recording has little: the gate then refuses the pose, not the fit
    least = min(MIN_AXIS_SPREAD, 0.5 * chain.axis_spread())
    for _ in range(HYPOTHESES if len(chain) > _SAMPLE else 1):
        sample = rng.permutation(len(chain))[:_SAMPLE]
        chosen = chain.part(sample)
        if chosen.axis_spread() < least:
            continue
        camera = solve(chosen)
        if not np.isfinite(camera).all():
            continue
        excess = _excess(chain, camera)
        cost = float(np.minimum(excess, 1.0).sum())
        if cost < lowest:
            best, lowest = excess <= 1.0, cost

    def fit(keep: BoolArray, _: ChainFit | None) -> ChainFit | None:
        part = chain.part(keep)
        if part.axis_spread() < least:
            return None
        start = solve(part)
        return refine(part, start) if np.isfinite(start).all() else None

    return fit_inliers(
        fit,
        lambda fitted: chain.residuals(fitted.hand_from_camera, fitted.base_from_target),
        best,
        InlierRule(KEEP_SIGMA, scale_from_inliers=True),
    )


def _excess(chain: Chain, hand_from_camera: FloatArray) -> FloatArray:
    """(n,) squared residual of each pair over the consensus limits; 1 at the limit."""
    mm, degrees = chain.residuals(hand_from_camera, chain.middle_target(hand_from_camera))
    return np.maximum(mm / CONSENSUS_MM, degrees / CONSENSUS_DEG) ** 2
