"""Force of a dynamic virtual fixture at given points and phases of the model."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import DvfModel, FloatArray, IntArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import check_shape
from dvf_ig.kernels.dynamic import force_batch, packed_fixture

from .blend import BLEND_CODES, Blend
from .device import COMMON_DEVICE, DeviceLimits
from .laws import Law
from .periodic import periodic_coefficients, periodic_powers
from .status import Status


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ForceSamples:
    """What the fixture answers at n points; vectors are in the frame in which the points were given.

    Attributes:
        force_n: (n, 3) N; zero unless the status is OK.
        distance_mm: (n,) signed distance, positive inside, blended between phases; NaN unless OK.
        gradient: (n, 3) its gradient, pointing into the organ; NaN unless OK.
        status: (n,) `Status` values.
        rate_mm_per_cycle: (n,) ∂d/∂φ, the point held still; NaN unless OK, and where nothing is known of it.
    """

    force_n: FloatArray
    distance_mm: FloatArray
    gradient: FloatArray
    status: IntArray
    rate_mm_per_cycle: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if len(self.rate_mm_per_cycle) != len(self.status):
            object.__setattr__(self, "rate_mm_per_cycle", np.full(len(self.status), np.nan))
        for array in (
            self.force_n,
            self.distance_mm,
            self.gradient,
            self.status,
            self.rate_mm_per_cycle,
        ):
            array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.status)

    def surface_speed_mm_s(self, phase_rate_hz: float) -> FloatArray:
        """(n,) how fast the surface through each point moves along ∇d/|∇d|, into the organ: −(∂d/∂t)/|∇d|.

        Args:
            phase_rate_hz: dφ/dt, one over the RR interval where the phase runs evenly.
        """
        norm = np.linalg.norm(self.gradient, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(-phase_rate_hz * self.rate_mm_per_cycle / norm)


class Evaluator:
    """A model, a law and a blend, ready to be asked for forces.

    Holds its own copy of the coefficients: kernels are quicker to call with arrays that are not read-only.

    Args:
        model: the dynamic fixture.
        law: force law.
        blend: "force" (corrected eq. 10), "distance" (one potential per instant) or "periodic" (as distance,
            twice continuously differentiable in phase; half as fast, for it reads four phases).
        device: what the haptic device can render.
    Raises:
        InvalidInputError: unknown blend, or a law beyond the device's limits.
    """

    def __init__(
        self, model: DvfModel, law: Law, *, blend: Blend = "force", device: DeviceLimits = COMMON_DEVICE
    ) -> None:
        if blend not in BLEND_CODES:
            raise InvalidInputError(f"unknown blend '{blend}'; choose one of {', '.join(BLEND_CODES)}")
        self.model = model
        self.law: Law = device.checked(law)
        self.blend: Blend = blend
        periodic = blend == "periodic"
        coefficients, timing = model.coefficients, model.timing
        self._coefficients = periodic_coefficients(coefficients, timing) if periodic else coefficients.copy()
        self._constants = (
            model.origin_mm,
            model.knot_spacing_mm,
            timing.fractions,
            periodic_powers(timing) if periodic else np.zeros((0, 4, 4)),
            law.parameters,
            BLEND_CODES[blend],
        )

    @property
    def coefficients(self) -> NDArray[np.float32]:
        """(n, cx, cy, cz) mm: those of the model, or of the periodic spline through its phases."""
        return self._coefficients

    def kernel_arguments(self, model_from_query: FloatArray) -> tuple[NDArray[np.float32], FloatArray]:
        """Leading arguments of `dvf_ig.kernels.dynamic.force_tick` and `force_batch`; map as (3, 4)."""
        return self._coefficients, packed_fixture(*self._constants, model_from_query)

    def force(self, xyz_mm: Any, model_phase: Any) -> ForceSamples:
        """Forces in the model's frame.

        Args:
            xyz_mm: (n, 3) points in the model's frame.
            model_phase: (n,) place in the model's cycle, taken modulo 1; one number serves all points.
        Raises:
            InvalidInputError: shapes that do not fit.
        """
        return self.force_through(np.eye(3, 4), xyz_mm, model_phase)

    def force_through(
        self, model_from_query: FloatArray, xyz_mm: Any, model_phase: Any, status: IntArray | None = None
    ) -> ForceSamples:
        """Forces in a query frame whose rigid map into the model's frame is (3, 4) `model_from_query`.

        Args:
            status: (n,) what is known beforehand; entries that are not OK get no force. None: all OK.
        """
        xyz = np.array(xyz_mm, dtype=np.float64, order="C")
        check_shape(xyz, "points", (None, 3))
        n = len(xyz)
        phase = np.array(model_phase, dtype=np.float64, order="C")
        if phase.ndim == 0:
            phase = np.full(n, phase)
        check_shape(phase, "model phase", (n,))
        known = np.full(n, int(Status.OK)) if status is None else np.array(status, dtype=np.int64)
        check_shape(known, "status", (n,))
        force, distance, gradient, rate = np.empty((n, 3)), np.empty(n), np.empty((n, 3)), np.empty(n)
        force_batch(
            *self.kernel_arguments(model_from_query), xyz, phase, force, distance, gradient, rate, known
        )
        return ForceSamples(force, distance, gradient, known, rate)
