"""Force of a dynamic virtual fixture at given points and phases of the model (Ren 2008, eqs 4–11)."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from dvf_ig.core import (
    BoolArray,
    CycleTiming,
    DvfModel,
    FloatArray,
    IntArray,
    InvalidInputError,
    Rigid,
    read_only_arrays,
)
from dvf_ig.core.arrays import check_shape
from dvf_ig.core.space.frames import check_frame, require_same_frame
from dvf_ig.kernels.dynamic import force_batch
from dvf_ig.kernels.fixture_field import packed_fixture

from .blend import BLEND_CODES, Blend
from .device import COMMON_DEVICE, DeviceLimits
from .laws import Law, require_reach
from .places import Status

DEGREE = 3
SUPPORT = DEGREE + 1
"""Intervals in the support of one cubic B-spline, and B-splines that are not zero on one interval."""


def periodic_powers(timing: CycleTiming) -> FloatArray:
    """(n, 4, 4) per interval, the coefficients of 1, α, α², α³ in the B-splines centred on phases i−1 … i+2.

    α in [0, 1] is the position between phase i and the next. The support of phase j's B-spline is j−2 to j+2.
    """
    count = len(timing)
    powers = np.empty((count, SUPPORT, SUPPORT))
    for i in range(count):
        start = _time(timing, i)
        width = _time(timing, i + 1) - start
        for m in range(SUPPORT):
            knots = np.array([_time(timing, i - 1 + m + offset) for offset in (-2, -1, 0, 1, 2)])
            basis = BSpline.basis_element(knots, extrapolate=False)
            factor = 1.0
            for power in range(SUPPORT):
                powers[i, power, m] = float(basis(start, nu=power)) * width**power / factor
                factor *= power + 1
    return powers


def periodic_coefficients(coefficients: NDArray[np.float32], timing: CycleTiming) -> NDArray[np.float32]:
    """(n, …) coefficients of the b_j in d(q, φ) = Σ_j N_j(φ) b_j(q), from those of the n phases.

    N_j are the cubic B-splines on the phase times continued around the cycle. The b_j are splines in space on
    the model's own knots, so interpolation at the phase times is one small cyclic system, the same for every
    coefficient. d is then C² in phase, and ∂d/∂φ is available.
    """
    count = len(timing)
    values = periodic_powers(timing)[:, 0, :]
    system = np.zeros((count, count))
    for i in range(count):
        for m in range(SUPPORT):
            system[i, (i - 1 + m) % count] += values[i, m]
    solved = np.linalg.solve(system, coefficients.reshape(count, -1).astype(np.float64))
    return np.ascontiguousarray(solved.reshape(coefficients.shape), dtype=np.float32)


def _time(timing: CycleTiming, k: int) -> float:
    """Time of phase `k` in cycles, continued before and after the cycle."""
    cycles, phase = divmod(k, len(timing))
    return cycles + float(timing.fractions[phase])


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ForceSamples:
    """Forces of a fixture at n points.

    Attributes:
        frame: frame of the vectors.
        force_n: (n, 3) N; zero unless the status is OK, or NO_PHASE of a wall: then that of its worst phase,
            to which all else belongs.
        distance_mm: (n,) signed distance, positive inside, blended between phases; NaN unless OK.
        gradient: (n, 3) gradient of the distance, pointing into the organ; NaN unless OK.
        status: (n,) `Status` values.
        rate_mm_per_cycle: (n,) ∂d/∂φ at the fixed point; NaN unless OK and computed.
        sigma_mm: (n,) standard deviation of the distance by those of pose and phase; NaN unless OK, or where
            they are not known.
        conflict: (n,) True where several fixtures oppose each other (`Composed`).
    """

    frame: str
    force_n: FloatArray
    distance_mm: FloatArray
    gradient: FloatArray
    status: IntArray
    rate_mm_per_cycle: FloatArray = field(default_factory=lambda: np.zeros(0))
    sigma_mm: FloatArray = field(default_factory=lambda: np.zeros(0))
    conflict: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def __post_init__(self) -> None:
        check_frame(self.frame)
        for name in ("rate_mm_per_cycle", "sigma_mm"):
            if len(getattr(self, name)) != len(self.status):
                object.__setattr__(self, name, np.full(len(self.status), np.nan))
        if len(self.conflict) != len(self.status):
            object.__setattr__(self, "conflict", np.zeros(len(self.status), dtype=np.bool_))

    def __len__(self) -> int:
        return len(self.status)


class Evaluator:
    """A model, a law and a blend, ready to evaluate forces.

    Holds its own copy of the coefficients: kernels are faster to call with arrays that are not read-only.

    Args:
        model: the dynamic fixture.
        law: force law.
        blend: "force" (corrected eq. 10), "distance" (one potential per instant) or "periodic" (as distance,
            twice continuously differentiable in phase; half as fast, for it reads four phases).
        device: what the haptic device can render.
        withhold_unseen: give no force where no slice shows the surface.
        contraction: how many times as far as in the model the heart contracts; 1 for a `PoseAndPhase`, which
            goes by its warp's.
    Raises:
        InvalidInputError: unknown blend, a law beyond the device's limits, or a forbidden region that is felt
            too far from the surface.
    """

    def __init__(
        self,
        model: DvfModel,
        law: Law,
        *,
        blend: Blend = "force",
        device: DeviceLimits = COMMON_DEVICE,
        withhold_unseen: bool = True,
        contraction: float = 1.0,
    ) -> None:
        if blend not in BLEND_CODES:
            raise InvalidInputError(f"unknown blend '{blend}'; choose one of {', '.join(BLEND_CODES)}")
        self.model = model
        require_reach(law)
        self.law: Law = device.checked(law)
        self.blend: Blend = blend
        periodic = blend == "periodic"
        coefficients, timing = model.coefficients.copy(), model.timing
        if contraction != 1.0:
            at_rest = model.coefficients[model.rest_phase]
            coefficients = at_rest + np.float32(contraction) * (coefficients - at_rest)
        self._coefficients = periodic_coefficients(coefficients, timing) if periodic else coefficients
        self._constants = (
            model.origin_mm,
            model.knot_spacing_mm,
            timing.fractions,
            periodic_powers(timing) if periodic else np.zeros((0, 4, 4)),
            law.parameters,
            BLEND_CODES[blend],
            model.seen if withhold_unseen else None,
        )

    @property
    def coefficients(self) -> NDArray[np.float32]:
        """(n, cx, cy, cz) mm: of the phases as the heart contracts, or of the spline through them."""
        return self._coefficients

    def kernel_arguments(self, model_from_query: Rigid) -> tuple[NDArray[np.float32], FloatArray]:
        """Leading arguments of `dvf_ig.kernels.dynamic.force_tick` and `force_batch`.

        Raises:
            FrameMismatchError: the model is in another frame than the map's target.
        """
        require_same_frame(model_from_query.target, self.model.frame, "registered model")
        matrix = np.ascontiguousarray(model_from_query.matrix[:3])
        return self._coefficients, packed_fixture(*self._constants, matrix)

    def force(self, xyz_mm: Any, model_phase: Any) -> ForceSamples:
        """Forces in the model's frame.

        Args:
            xyz_mm: (n, 3) points in the model's frame.
            model_phase: (n,) phase of the model's cycle, taken modulo 1; or one number for all points.
        Raises:
            InvalidInputError: shapes that do not fit.
        """
        frame = self.model.frame
        return self.force_through(Rigid.identity(frame, frame), xyz_mm, model_phase)

    def force_through(
        self, model_from_query: Rigid, xyz_mm: Any, model_phase: Any, status: IntArray | None = None
    ) -> ForceSamples:
        """Forces in another frame than the model's.

        Args:
            model_from_query: rigid map of the query frame into the model's.
            xyz_mm: (n, 3) points in the query frame.
            model_phase: as in `force`.
            status: (n,) `Status` of the input; entries that are not OK get no force, except that a forbidden
                region has that of its worst phase at NO_PHASE. None: all OK.
        Raises:
            FrameMismatchError: the model is in another frame than the map's target.
            InvalidInputError: shapes that do not fit.
        """
        xyz, phase, codes = checked_query(xyz_mm, model_phase, status)
        n = len(xyz)
        force, distance, gradient, rate = np.empty((n, 3)), np.empty(n), np.empty((n, 3)), np.empty(n)
        force_batch(
            *self.kernel_arguments(model_from_query), xyz, phase, force, distance, gradient, rate, codes
        )
        return ForceSamples(model_from_query.source, force, distance, gradient, codes, rate)


def checked_query(
    xyz_mm: Any, model_phase: Any, status: IntArray | None
) -> tuple[FloatArray, FloatArray, IntArray]:
    """(n, 3) points, (n,) phases and (n,) statuses of `force_through`, as writable copies.

    Raises:
        InvalidInputError: shapes that do not fit.
    """
    xyz = np.array(xyz_mm, dtype=np.float64, order="C")
    check_shape(xyz, "points", (None, 3))
    n = len(xyz)
    phase = np.array(model_phase, dtype=np.float64, order="C")
    if phase.ndim == 0:
        phase = np.full(n, phase)
    check_shape(phase, "model phase", (n,))
    codes = np.full(n, int(Status.OK)) if status is None else np.array(status, dtype=np.int64)
    check_shape(codes, "status", (n,))
    return xyz, phase, codes
