"""Phases of slices that were each acquired at another heart rate, by the end-systole of each.

Systole hardly shortens as the heart beats faster, so that end-systole comes at another fraction of every
slice's own cycle. Phase φ of the common cycle is the fraction of a slice's cycle that lies as far between its
end-diastole and its end-systole, or from there to its next end-diastole. Each slice's end-systole is the one
with which its contraction over the cycle follows the mean of all.
"""

from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import BoolArray, CycleTiming, FloatArray, IntArray, read_only_arrays

from .cycle import CycleMotion
from .free_form import FreeForm, volume_ratio

LARGEST = 0.09
"""Largest deviation of a slice's end-systole, of a cycle: RR intervals that differ by a quarter."""
SIGMA = 0.03
"""Standard deviation of that: RR intervals of 10 %, where systole keeps its length."""
TRIED = 37
"""Number of deviations tried; the middle one is none."""
LEAST_NOISE, CORRELATED = 0.05, 3.0
"""Least standard deviation of a contraction of size 1, and how many neighbouring phases count as one."""
LEAST_SHARE = 0.4
"""A slice that contracts by less than this share of the median says nothing about its end-systole."""
ROUNDS, LEAST_PHASES = 3, 8


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SlicePhases:
    """End-systole of every slice of a stack.

    Attributes:
        since_ed: (n,) fractions of the cycle from end-diastole, increasing from 0.
        course: (n,) mean contraction of the slices at these, 0 to about 1, in the common cycle.
        common_es: end-systole of the common cycle, as a fraction from end-diastole; es: (nz,) of each slice.
    """

    since_ed: FloatArray
    course: FloatArray
    common_es: float
    es: FloatArray

    def es_of(self, curve: FloatArray) -> float:
        """End-systole with which a curve (n,) over one slice's own cycle follows the course best.

        What deviates from the course with the common end-systole counts as noise, so that the curve of a
        slice whose motion is badly tracked moves its end-systole little from the common one.
        """
        deviations = np.linspace(-LARGEST, LARGEST, TRIED)
        off = np.array(
            [self.in_common(curve, self.common_es + float(one)) - self.course for one in deviations]
        )
        noise = max(LEAST_NOISE, float(off[TRIED // 2].std()))
        cost = (off**2).sum(axis=1) / (noise**2 * CORRELATED) + (deviations / SIGMA) ** 2
        return self.common_es + float(deviations[int(np.argmin(cost))])

    def in_common(self, curve: FloatArray, own_es: float) -> FloatArray:
        """(n,) curve of a slice's own cycle at the phases of the common one, of size 1."""
        at = own_fraction(self.since_ed, own_es, self.common_es)
        return np.asarray(np.interp(at, self.since_ed, curve, period=1.0)) / max(float(curve.max()), 1e-9)


def slice_phases(motion: CycleMotion, timing: CycleTiming, blood: BoolArray) -> SlicePhases:
    """Find the end-systole of every slice by how its blood contracts.

    Args:
        timing: of the stack.
        blood: (nx, ny, nz) of the left ventricle's cavity at end-diastole, or of the organ.
    """
    since, order = since_end_diastole(timing, motion.ed_phase)
    curves = _contractions(motion, blood)[:, order]
    size = curves.max(axis=1)
    usable = size > LEAST_SHARE * np.median(size[size > 0.0]) if (size > 0.0).any() else size > 0.0
    course = np.zeros(len(since))
    if usable.any():
        course = (curves[usable] / size[usable, None]).mean(axis=0)
    middle = float(since[course.argmax()])
    phases = SlicePhases(since, course, middle, np.full(len(curves), middle))
    if len(since) < LEAST_PHASES or not LARGEST < middle < 1.0 - LARGEST:
        return phases
    for _ in range(ROUNDS):
        fitted = np.array([phases.es_of(curve) for curve in curves[usable]])
        es = np.full(len(curves), middle)
        es[usable] = fitted + middle - fitted.mean()
        aligned = [
            phases.in_common(curve, own) for curve, own in zip(curves[usable], es[usable], strict=True)
        ]
        phases = SlicePhases(since, np.mean(aligned, axis=0), middle, es)
    return phases


def own_fraction(fractions: FloatArray, own_es: float, common_es: float) -> FloatArray:
    """Fraction of a slice's own cycle at fractions of the common one, both from end-diastole."""
    return np.interp(fractions, [0.0, common_es, 1.0], [0.0, own_es, 1.0])


def _contractions(motion: CycleMotion, blood: BoolArray) -> FloatArray:
    """(nz, n) share by which the blood of each slice has contracted in each phase; 0 without blood."""
    inside = np.asarray(motion.cropped(blood))
    slices, nz = np.nonzero(inside)[2], inside.shape[2]
    counts = np.bincount(slices, minlength=nz)
    ratios = [volume_ratio(d.on_voxels(), motion.grid.spacing_mm, inside) for d in motion.deformations]
    sums = np.stack([np.bincount(slices, ratio, nz) for ratio in ratios], axis=1)
    out = np.zeros((blood.shape[2], len(ratios)))
    shown = np.flatnonzero(counts)
    out[shown + motion.start[2]] = 1.0 - sums[shown] / counts[shown, None]
    return out


def since_end_diastole(timing: CycleTiming, ed_phase: int) -> tuple[FloatArray, IntArray]:
    """(n,) fractions of the cycle from end-diastole, increasing, and the phases in that order."""
    since = (timing.fractions - timing.fractions[ed_phase]) % 1.0
    order = np.argsort(since)
    return since[order], order


def retimed(motion: CycleMotion, timing: CycleTiming, phases: SlicePhases) -> CycleMotion:
    """Give every slice the motion of its own cycle at the phases of the common one.

    A free-form deformation of a stack has its knots at the slices; its control points change by the least
    that gives every slice its motion. Displacements by demons stay as they are.
    """
    first = motion.deformations[0]
    if not isinstance(first, FreeForm):
        return motion
    since, order = since_end_diastole(timing, motion.ed_phase)
    points = np.stack([d.coefficients for d in motion.deformations if isinstance(d, FreeForm)])[order]
    count = motion.grid.shape[2]
    from_points = sum(np.eye(count, count + 2, k) * share for k, share in enumerate((1 / 6, 4 / 6, 1 / 6)))
    before = np.einsum("kz,nxyzd->nxykd", from_points, points)
    after = np.empty_like(before)
    for k in range(count):
        own = own_fraction(since, float(phases.es[k + motion.start[2]]), phases.common_es)
        after[..., k, :] = _read(before[..., k, :], since, own)
    moved = points + np.einsum("zk,nxykd->nxyzd", np.linalg.pinv(from_points), after - before)
    deformations = tuple(FreeForm(first.lattice, moved[row]) for row in np.argsort(order))
    return replace(motion, deformations=deformations)


def _read(values: FloatArray, fractions: FloatArray, at: FloatArray) -> FloatArray:
    """Values (n, …) along the first axis, linear and cyclic between fractions."""
    n = len(fractions)
    after = np.searchsorted(fractions, at, side="right") % n
    before = (after - 1) % n
    width = (fractions[after] - fractions[before]) % 1.0
    weight = (at - fractions[before]) % 1.0 / np.where(width > 0.0, width, 1.0)
    weight = weight.reshape(-1, *([1] * (values.ndim - 1)))
    return np.asarray((1.0 - weight) * values[before] + weight * values[after])
