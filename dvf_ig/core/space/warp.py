"""A smooth change of the heart's shape as a pull-back, and its motion from one estimate to the next.

What lies at q at the registered pose belongs to q' = q − m(q) in the model. m and the variance of the wall's
place along its normal are one cubic spline of four lanes, (m_x, m_y, m_z, σ²), on a grid of CELLS³ cells;
beyond the grid they are as at its border. `dvf_ig.kernels.warp` is the form for kernels.

A heart that contracts g times as far as the model has d'(q, φ) = d₀ + g (d_φ − d₀), with d₀ the distance at
the R peak's phase and d_φ that at φ, both at q'.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import BSpline, NdBSpline

from dvf_ig.core.arrays import FloatArray, frozen, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError

from .frames import require_same_frame
from .pose_motion import UPDATE_MM_PER_S
from .rigid import Rigid

CELLS = 12
COEFFICIENTS = CELLS + 3
"""Coefficients along each axis; every warp has as many, so that a servo has their place before it starts."""
CONTRACTED_MM = 15.0
"""How far walls move at most over the cycle, by which the speed of a change of contraction is bounded."""
TURNS = 8
"""Steps by which a place of the patient is found from that in the model."""
RIGID_SIGMA_MM = 0.8
"""Standard deviation of the surface where no change of shape was estimated: of small changes of shape,
retiming and the model together. In recordings of tuning hearts 1001–1003 and 1021 errors of the distance are
1.29 σ without it, 0.96 σ with it; at 0.95 the wall is then inside the true surface at 5 % of the points."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Warp:
    """A change of shape at one pose.

    Attributes:
        frame: of the model.
        origin_mm: (3,) of knot 0; coefficients j to j + 3 belong to the cell after knot j.
        knot_mm: pitch of the knots.
        coefficients: (COEFFICIENTS, COEFFICIENTS, COEFFICIENTS, 4) float32: m in mm, variance in mm².
        contraction: how many times as far as in the model the heart contracts.
    Raises:
        InvalidInputError: shapes that do not fit, no positive pitch, or numbers that are not finite.
    """

    frame: str
    origin_mm: FloatArray
    knot_mm: float
    coefficients: NDArray[np.float32]
    contraction: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin_mm", frozen_floats(self.origin_mm, "origin of a warp", (3,)))
        coefficients = frozen(
            self.coefficients, "coefficients of a warp", (*[COEFFICIENTS] * 3, 4), np.float32
        )
        object.__setattr__(self, "coefficients", coefficients)
        if not (self.knot_mm > 0.0 and np.isfinite(coefficients).all() and math.isfinite(self.contraction)):
            raise InvalidInputError("a warp needs a positive pitch of its knots and finite coefficients")

    @classmethod
    def through(
        cls,
        frame: str,
        origin_mm: FloatArray,
        knot_mm: float,
        m_mm: FloatArray,
        variance_mm2: FloatArray,
        contraction: float = 1.0,
    ) -> "Warp":
        """Interpolate m, (n, 3), and the variance, (n,), given at `knots`."""
        samples = np.column_stack([m_mm, variance_mm2]).reshape(*[CELLS + 1] * 3, 4)
        lanes = [_spline_coefficients(samples[..., lane]) for lane in range(4)]
        return cls(frame, origin_mm, knot_mm, np.stack(lanes, axis=-1).astype(np.float32), contraction)

    def at(self, places_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 3) m and (n,) variance of the wall's place at (n, 3) places."""
        knots = np.clip((places_mm - self.origin_mm) / self.knot_mm, 0.0, float(CELLS))
        lanes = _spline(self)(knots)
        return np.ascontiguousarray(lanes[:, :3]), np.maximum(lanes[:, 3], 0.0)

    def model_places(self, patient_mm: FloatArray) -> FloatArray:
        """(n, 3) places q − m(q) of the model that belong to (n, 3) places q of the patient."""
        return patient_mm - self.at(patient_mm)[0]

    def patient_places(self, model_mm: FloatArray) -> FloatArray:
        """(n, 3) places q of the patient that belong to (n, 3) places q − m(q) of the model."""
        places = model_mm
        for _ in range(TURNS):
            places = model_mm + self.at(places)[0]
        return places

    def slope(self, places_mm: FloatArray) -> FloatArray:
        """(n, 3, 3) Dm, ∂m_i/∂x_j, at (n, 3) places, by differences."""
        step = 1e-3 * self.knot_mm
        columns = [
            (self.at(places_mm + e)[0] - self.at(places_mm - e)[0]) / (2.0 * step) for e in step * np.eye(3)
        ]
        return np.stack(columns, axis=2)

    @property
    def steepest(self) -> float:
        """Largest ‖Dm‖ at knots and midway between them: below 1 nothing folds. Computed once."""
        return _steepest(self)

    def at_pose(self, registered: Rigid, pose: Rigid) -> "Warp":
        """Return the warp that puts the walls, at another pose, where this one does at the registered one.

        A spline holds a rigid motion's displacement exactly; that m is taken a small step aside is left out.
        """
        moved = registered @ pose.inverse()
        places = knots(self.origin_mm - self.knot_mm, self.knot_mm, COEFFICIENTS - 1)
        shift = (places - moved.apply_array(places)).reshape(*[COEFFICIENTS] * 3, 3)
        coefficients = self.coefficients.astype(np.float64)
        coefficients[..., :3] += shift
        return replace(self, coefficients=coefficients.astype(np.float32))

    def unwarped(self) -> "Warp":
        """Return no change of shape, on the same knots."""
        coefficients = np.zeros_like(self.coefficients)
        coefficients[..., 3] = RIGID_SIGMA_MM**2
        return replace(self, coefficients=coefficients, contraction=1.0)


@lru_cache(maxsize=8)
def _spline(warp: Warp) -> NdBSpline:
    """Return the four lanes as one spline of the knot coordinate: as fast as two lanes one by one."""
    axis = np.arange(COEFFICIENTS + 4) - 3.0
    return NdBSpline((axis, axis, axis), warp.coefficients.astype(np.float64), 3)


@lru_cache(maxsize=4)
def _steepest(warp: Warp) -> float:
    apart = np.linspace(0.0, CELLS, 2 * CELLS + 1)[:, None] + 1.0 - np.arange(COEFFICIENTS)
    spline = BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)
    value, slope = np.nan_to_num(spline(apart)), np.nan_to_num(spline.derivative()(apart))
    m_mm = warp.coefficients[..., :3].astype(np.float64)
    weights = ((slope, value, value), (value, slope, value), (value, value, slope))
    columns = [np.einsum("ai,bj,ck,ijkl->abcl", *each, m_mm, optimize=True) for each in weights]
    slopes = np.stack(columns, axis=-1).reshape(-1, 3, 3)
    squares = (slopes**2).sum(axis=(1, 2))  # of three singular values: the largest has a third or more
    steep = slopes[squares >= squares.max() / 3.0]
    return float(np.linalg.norm(steep, ord=2, axis=(1, 2)).max() / warp.knot_mm)


def knots(origin_mm: FloatArray, knot_mm: float, cells: int = CELLS) -> FloatArray:
    """(n, 3) places of a grid's knots."""
    axis = knot_mm * np.arange(cells + 1)
    return np.asarray(
        np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3) + origin_mm
    )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class WarpMotion:
    """Linear motion from one warp to another between two times; made by `still` and `towards`.

    Attributes:
        start, end: before and after, on the same knots.
        start_s, end_s: both −inf for a constant warp.
    """

    start: Warp
    end: Warp
    start_s: float
    end_s: float

    def __post_init__(self) -> None:
        require_same_frame(self.start.frame, self.end.frame, "change of shape")
        same = self.start.knot_mm == self.end.knot_mm and (self.start.origin_mm == self.end.origin_mm).all()
        if not same or not self.start_s <= self.end_s:
            raise InvalidInputError(
                "a change of shape moves between warps on the same knots, forward in time"
            )

    @classmethod
    def still(cls, warp: Warp) -> "WarpMotion":
        """Build the motion of a constant warp."""
        return cls(warp, warp, -math.inf, -math.inf)

    @classmethod
    def towards(cls, before: "WarpMotion | None", target: Warp | None, start_s: float) -> "WarpMotion | None":
        """Build the motion to another warp, from none or to none; None from none to none.

        No place moves faster than UPDATE_MM_PER_S.
        """
        if before is not None:
            now = before.at(start_s)
            target = now.unwarped() if target is None else target
        elif target is None:
            return None
        else:
            now = target.unwarped()
        apart = np.linalg.norm((target.coefficients - now.coefficients)[..., :3], axis=-1)
        apart_mm = float(apart.max()) + CONTRACTED_MM * abs(target.contraction - now.contraction)
        return cls(now, target, start_s, start_s + apart_mm / UPDATE_MM_PER_S)

    def at(self, t_s: float) -> Warp:
        """Return the warp at one time."""
        if t_s >= self.end_s:
            return self.end
        weight = np.float32(self._weight(t_s))
        mixed = self.start.coefficients + weight * (self.end.coefficients - self.start.coefficients)
        contraction = float(self.contraction(np.array([t_s]))[0])
        return replace(self.end, coefficients=mixed, contraction=contraction)

    def contraction(self, t_s: FloatArray) -> FloatArray:
        """(n,) how many times as far as in the model the heart contracts, at (n,) times."""
        weight = np.array([self._weight(t) for t in t_s.tolist()])
        return np.asarray(self.start.contraction + weight * (self.end.contraction - self.start.contraction))

    def pull(self, places_mm: FloatArray, t_s: FloatArray) -> "Pull":
        """Evaluate the warps at (n, 3) places and (n,) times."""
        weight = np.array([self._weight(t) for t in t_s.tolist()])
        moving = (t_s > self.start_s) & (t_s < self.end_s)
        (before, variance_before), (after, variance_after) = self.start.at(places_mm), self.end.at(places_mm)
        rate, part = np.zeros_like(places_mm), weight[:, None]
        rate[moving] = (after - before)[moving] / (self.end_s - self.start_s)
        slope_before, slope_after = self.start.slope(places_mm), self.end.slope(places_mm)
        return Pull(
            before + part * (after - before),
            slope_before + part[:, :, None] * (slope_after - slope_before),
            variance_before + weight * (variance_after - variance_before),
            rate,
        )

    def _weight(self, t_s: float) -> float:
        """Compute the share of `end` at one time."""
        if t_s >= self.end_s:
            return 1.0
        return 0.0 if t_s <= self.start_s else (t_s - self.start_s) / (self.end_s - self.start_s)


class Pull(NamedTuple):
    """A change of shape at n places and times.

    Attributes:
        m_mm: (n, 3); slope: (n, 3, 3) Dm.
        variance_mm2: (n,) of the wall's place along its normal.
        rate_mm_s: (n, 3) ṁ.
    """

    m_mm: FloatArray
    slope: FloatArray
    variance_mm2: FloatArray
    rate_mm_s: FloatArray


def _spline_coefficients(samples: FloatArray) -> FloatArray:
    """(nx + 2, ny + 2, nz + 2) coefficients of the cubic spline through samples at knots."""
    filtered = ndimage.spline_filter(samples, order=3, output=np.float64, mode="mirror")
    return np.asarray(np.pad(filtered, 1, mode="reflect"))
