"""Whether an ECG is late or early against the images, by the cyclic motion that the images show themselves.

Images change most when the heart moves fastest. With v(φ) the speed of the heart of the model over its cycle,
averaged over the time between two frames, and u how far the probe moved in it,

    log change = c + b·√v(φ(t) + δ) + a₁·√u + a₂·u + a₃·u² + slow trend,   b > 0,

is fitted by least squares for every common shift δ of the cycle. The shift of the least residual S is the
ECG's delay; with n independent pairs n/2·log(S(0)/S(δ)) is its log-likelihood ratio against none, and
n/2·log(S(no v)/S(δ)) that of cyclic motion against none at all: below KNOWN_LOG_RATIO nothing is known.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.cardiac import beat_phase
from dvf_ig.core import BoolArray, FloatArray, ImageMap, PoseStream, TrackedSequence, read_only_arrays

SHIFTS = 40
PAIRS_A_BEAT = 5.0
"""Independent pairs of frames: half of all, and no more than this in a beat."""
SMEAR = np.linspace(-0.5, 0.5, 5)
LATE_S = 0.08
"""As of a registration (`registration.evidence.phase_offset`), which sees the same with a pose."""
KNOWN_LOG_RATIO = 4.0
CERTAIN_LOG_RATIO = 8.0
"""69 undisturbed recordings of 20 s (hearts 101 to 105, 1001 to 1005; sweeping or resting probes, breathing,
poor images, ectopy, 12 and 25 frames/s; physiological motion, 10 of 5 mm) give delays of -33 to 3 ms where
they are known (50). With the ECG 300 ms late it is 264 to 305 ms: 51 are suspicious, 45 certain. R peaks of
another rate, of which the images know nothing, give ratios of 6.7 at most in 345 fits, above 4 in 5. Motion
of 5 mm under a sweeping probe gives no answer in 9 of 10."""
LEAST_PAIRS = 60
BLOCK_PX = 6
"""Grey levels are averaged over blocks of this size: speckle, which changes with any motion, averages out."""
MOST_FRAMES = 1200
"""More are not read: of a longer recording the first and the last half of as many."""
LONGEST_STEP = 1.8
"""Pairs further apart than this many frame periods have a frame missing between them."""


@dataclass(frozen=True, slots=True)
class EcgDelay:
    """Delay of the ECG against the motion in the images.

    Attributes:
        delay_s: of the ECG against the images; negative if it is early.
        cyclic_log_ratio: of motion in the rhythm of the ECG against none; NaN where nothing could be fitted.
        delay_log_ratio: of this delay against none.
    """

    delay_s: float
    cyclic_log_ratio: float
    delay_log_ratio: float

    @property
    def known(self) -> bool:
        return self.cyclic_log_ratio >= KNOWN_LOG_RATIO

    @property
    def suspicious(self) -> bool:
        """The ECG contradicts the images, more likely than not."""
        return self.known and abs(self.delay_s) > LATE_S and self.delay_log_ratio >= KNOWN_LOG_RATIO

    @property
    def certain(self) -> bool:
        return self.suspicious and self.delay_log_ratio >= CERTAIN_LOG_RATIO


UNKNOWN = EcgDelay(np.nan, np.nan, 0.0)
"""Too few images, or too few beats."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CycleSpeed:
    """How fast a heart moves over its cycle, in any unit.

    Attributes:
        phase: (m,) increasing, in [0, 1).
        speed: (m,) not negative.
    """

    phase: FloatArray
    speed: FloatArray

    def at(self, phase: FloatArray) -> FloatArray:
        """(...) by linear interpolation around the cycle."""
        turns = np.concatenate([self.phase[-1:] - 1.0, self.phase, self.phase[:1] + 1.0])
        speeds = np.concatenate([self.speed[-1:], self.speed, self.speed[:1]])
        return np.asarray(np.interp(phase % 1.0, turns, speeds))


def speed_between(amounts: FloatArray, fractions: FloatArray) -> CycleSpeed:
    """From (m,) amounts of motion, each from a phase of the cycle to the next, the last to the first."""
    ends = np.append(fractions[1:], fractions[0] + 1.0)
    middle = 0.5 * (fractions + ends) % 1.0
    order = np.argsort(middle)
    return CycleSpeed(middle[order], (amounts / (ends - fractions))[order])


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ImageChange:
    """Change over (n,) pairs of consecutive frames, both valid and tracked.

    Attributes:
        t_s: (n,) middle of the pair, video clock.
        change: (n,) mean absolute difference of their grey levels.
        moved_mm: (n,) mean distance by which the probe moved points of the image.
        step_s: usual time between two frames.
    """

    t_s: FloatArray
    change: FloatArray
    moved_mm: FloatArray
    step_s: float


def ecg_delay(images: ImageChange, lag_s: float, peaks_s: FloatArray, heart: CycleSpeed) -> EcgDelay:
    """The delay that explains the images' changes best.

    Args:
        lag_s: t_tracker = t_video + lag_s.
        peaks_s: (k,) R peaks by the ECG.
    """
    beats = beat_phase(peaks_s, images.t_s + lag_s)
    inside = np.isfinite(beats.rr_s)
    if np.count_nonzero(inside) < LEAST_PAIRS or not heart.speed.max() > 0:
        return UNKNOWN
    phase, rr_s = beats.phi[inside], float(np.median(beats.rr_s[inside]))
    change, plain = np.log(images.change[inside]), without_heart(images.moved_mm[inside])
    none = residual_of_fit(plain, change)[0]
    left, rise = residuals_with(plain, shifted_speeds(heart, phase, images.step_s / rr_s), change)
    left = np.where(rise > 0, left, none)  # images do not change less in fast motion
    t_s = images.t_s[inside]
    beats_seen = np.count_nonzero((peaks_s >= t_s[0] + lag_s) & (peaks_s <= t_s[-1] + lag_s))
    half_n = 0.5 * min(0.5 * len(change), PAIRS_A_BEAT * beats_seen)
    return _best(half_n * np.log(none / left), rr_s)


def delay_drift_s(images: ImageChange, lag_s: float, peaks_s: FloatArray, heart: CycleSpeed) -> float | None:
    """Growth of the delay from the first half of the pairs to the second; None if not known."""
    half = len(images.t_s) // 2
    parts = (_part(images, part) for part in (slice(0, half), slice(half, None)))
    delays = [ecg_delay(part, lag_s, peaks_s, heart) for part in parts]
    return delays[1].delay_s - delays[0].delay_s if all(one.known for one in delays) else None


def without_heart(moved: FloatArray) -> FloatArray:
    """(n, 6) what else makes images change: the probe's motion (n,), mm, and what changes slowly."""
    trend = np.linspace(-1.0, 1.0, len(moved))
    return np.column_stack([np.ones_like(moved), np.sqrt(moved), moved, moved**2, trend, trend**2])


def shifted_speeds(heart: CycleSpeed, phase: FloatArray, step: float) -> FloatArray:
    """(SHIFTS, n) √ of the mean speed over a step of the cycle about (n,) phases, for every shift of it."""
    shifted = phase + np.arange(SHIFTS)[:, None] / SHIFTS
    return np.asarray(np.sqrt(np.mean([heart.at(shifted + part * step) for part in SMEAR], axis=0)))


def residual_of_fit(columns: FloatArray, change: FloatArray) -> tuple[float, FloatArray]:
    """Squared residual of a linear fit, and its coefficients."""
    fit = np.asarray(np.linalg.lstsq(columns, change, rcond=None)[0], dtype=np.float64)
    left = change - columns @ fit
    return float(left @ left) + 1e-12, fit


def residuals_with(
    plain: FloatArray, speeds: FloatArray, change: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fit with one more column at a time: the squared residual with each, and its coefficient.

    What the (n, m) columns `plain` explain is taken from the change and from each of the (k, n) speeds.

    Source: Frisch and Waugh 1933.
    """
    axes, sizes, _ = np.linalg.svd(plain, full_matrices=False)
    axes = axes[:, sizes > np.finfo(np.float64).eps * max(plain.shape) * sizes[0]]
    change = change - axes @ (axes.T @ change)
    alone = speeds - (speeds @ axes) @ axes.T
    energy = (alone**2).sum(axis=1)
    fit = np.where(energy > 0, alone @ change / np.where(energy > 0, energy, 1.0), 0.0)
    return ((change - fit[:, None] * alone) ** 2).sum(axis=1) + 1e-12, fit


def _best(ratios: FloatArray, rr_s: float) -> EcgDelay:
    """Interpolate the best of (SHIFTS,) log-likelihood ratios against no cyclic motion by a parabola."""
    best = int(np.argmax(ratios))
    before, here, after = (float(ratios[(best + k) % SHIFTS]) for k in (-1, 0, 1))
    bend = before - 2.0 * here + after
    part = 0.5 * (before - after) / bend if bend < 0 else 0.0
    shift = ((best + part) / SHIFTS + 0.5) % 1.0 - 0.5
    top = here - 0.25 * (before - after) * part
    return EcgDelay(shift * rr_s, top, max(top - float(ratios[0]), 0.0))


def _part(images: ImageChange, part: slice) -> ImageChange:
    return ImageChange(images.t_s[part], images.change[part], images.moved_mm[part], images.step_s)


def image_change(
    recorded: TrackedSequence, probe: PoseStream, image: ImageMap, shown: BoolArray
) -> ImageChange:
    """Measure it.

    Args:
        recorded: with images.
        probe: its poses.
        image: probe_from_image.
        shown: (rows, columns) the insonified sector.
    """
    blocks = _blocks(shown[None].astype(np.float64))[0] > 0.99
    count, images = len(recorded), recorded.images
    begins = [0] if count <= MOST_FRAMES else [0, count - MOST_FRAMES // 2]
    length = min(count, MOST_FRAMES // len(begins))
    pairs, change = np.empty(0, dtype=np.int64), np.empty(0)
    if images is not None and blocks.any():
        parts = [_differences(images[begin : begin + length], blocks) for begin in begins]
        pairs = np.concatenate([b + np.arange(len(part)) for b, part in zip(begins, parts, strict=True)])
        change = np.concatenate(parts)
    good = recorded.image_valid & probe.valid
    steps_s = np.diff(recorded.t_s)[pairs]
    step_s = float(np.median(steps_s)) if len(pairs) else np.nan
    used = good[pairs] & good[pairs + 1] & (steps_s < LONGEST_STEP * step_s) & (change > 0)
    first = pairs[used]
    return ImageChange(
        t_s=0.5 * (recorded.t_s[first] + recorded.t_s[first + 1]),
        change=change[used],
        moved_mm=_moved_mm(probe, first, grid_mm(image, shown.shape)),
        step_s=step_s,
    )


def _blocks(images: NDArray[np.float64]) -> FloatArray:
    """(n, r, c) means over whole blocks."""
    rows, columns = (size // BLOCK_PX for size in images.shape[1:])
    cut = images[:, : rows * BLOCK_PX, : columns * BLOCK_PX]
    return np.asarray(cut.reshape(len(images), rows, BLOCK_PX, columns, BLOCK_PX).mean(axis=(2, 4)))


def _differences(images: NDArray[np.uint8], blocks: BoolArray) -> FloatArray:
    """(n − 1,) mean absolute difference of each frame and the next, one frame in memory at a time."""
    out, before = np.empty(max(len(images) - 1, 0)), np.empty(0)
    for i, frame in enumerate(images):
        now = _blocks(frame[None].astype(np.float64))[0][blocks]
        if i:
            out[i - 1] = np.abs(now - before).mean()
        before = now
    return out


def grid_mm(image: ImageMap, shape: tuple[int, ...]) -> FloatArray:
    """(16, 3) points all over the image, frame "probe"."""
    sides = np.meshgrid(np.linspace(0, shape[1], 4), np.linspace(0, shape[0], 4))
    return image.apply_pixels(np.stack(sides, axis=-1).reshape(-1, 2)).xyz_mm


def _moved_mm(probe: PoseStream, first: NDArray[np.int64], points_mm: FloatArray) -> FloatArray:
    turn = probe.rotations[first + 1] - probe.rotations[first]
    shift = probe.translations_mm[first + 1] - probe.translations_mm[first]
    return moved_between_mm(turn, shift, points_mm)


def moved_between_mm(turns: FloatArray, shifts_mm: FloatArray, points_mm: FloatArray) -> FloatArray:
    """(n,) mean distance by which points (p, 3) move, by differences of (n, 3, 3) and (n, 3) poses."""
    away = np.einsum("nij,pj->npi", turns, points_mm) + shifts_mm[:, None]
    return np.asarray(np.linalg.norm(away, axis=2).mean(axis=1))
