"""The pose-and-phase transform: a tracked tool at a time, in the model and in its cycle, and its force back.

    (p_tracker, t) ↦ (p_mr, model phase, the rate of both, σ_d, Status)

One value owns pose, phase, retiming, how well they are known and until when they may be used. It holds from
one event to the next: a new pose, an R peak, a confirmation. Within it everything is a function of time.
"""

import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from dvf_ig.core import (
    HEART_RADIUS_MM,
    RIGID_SIGMA_MM,
    FloatArray,
    IntArray,
    InvalidInputError,
    PhaseForecast,
    PhaseState,
    PoseMotion,
    RetimingCurve,
    Rigid,
    WarpMotion,
    read_only_arrays,
    require_same_frame,
)
from dvf_ig.core.arrays import check_shape, frozen_floats
from dvf_ig.kernels.place import packed_pose_and_phase, packed_warps
from dvf_ig.kernels.pose_and_phase import DISTANCE_SIGMA, GUIDED_SIZE, guided_batch, guided_tick

from .evaluator import Evaluator, ForceSamples
from .places import PlacesInModel, Status

TRACKER_FRAME = "tracker"
"""Frame of the tool where there is no pose to name it."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PoseAndPhase:
    """A tracked tool and a time to the model's frame and cycle; forces back in the tracker's frame.

    Attributes:
        pose: mr_from_tracker over time; None without a registration that may be used.
        phase: as known at the last event of the ECG.
        retiming: of the current beat; None if its length is unknown.
        covariance_mm2: (6, 6) of the pose in the coordinates of `dvf_ig.registration.PoseChart` about
            `center_mm`; None if unknown: σ_d is then NaN.
        center_mm: (3,) centre of the heart, model frame.
        pose_until_s: the pose is withheld from then on, unless it was confirmed.
        warp: change of the heart's shape over time, at the pose; None of a heart that has kept its shape.
    """

    pose: PoseMotion | None
    phase: PhaseForecast
    retiming: RetimingCurve | None
    covariance_mm2: FloatArray | None = None
    center_mm: FloatArray = field(default_factory=lambda: np.zeros(3))
    pose_until_s: float = math.inf
    warp: WarpMotion | None = None
    packed: Any = field(init=False, repr=False)
    """(1,) all of it in one record for `dvf_ig.kernels.place` and `dvf_ig.kernels.pose_and_phase`."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "center_mm", frozen_floats(self.center_mm, "centre of the heart", (3,)))
        if self.covariance_mm2 is not None:
            covariance = frozen_floats(self.covariance_mm2, "covariance of the pose", (6, 6))
            _check_covariance(covariance)
            object.__setattr__(self, "covariance_mm2", covariance)
        if math.isnan(self.pose_until_s):
            raise InvalidInputError(
                "the pose is withheld from NaN s on; needed a time, or infinity for never"
            )
        if self.warp is not None and self.pose is not None:
            require_same_frame(self.warp.end.frame, self.pose.end.target, "change of shape")
        packed = packed_pose_and_phase(
            self.pose,
            self.pose_until_s,
            self.phase,
            self.retiming,
            self.covariance_mm2,
            self.center_mm,
            self.warp,
        )
        packed.setflags(write=False)
        object.__setattr__(self, "packed", packed)

    def at(self, xyz_tracker_mm: Any, t_s: Any) -> PlacesInModel:
        """Places in the model and in its cycle.

        Args:
            xyz_tracker_mm: (n, 3) points, tracker frame.
            t_s: (n,) times of these, or one for all.
        Raises:
            InvalidInputError: shapes that do not fit.
        """
        xyz, t = _points_and_times(xyz_tracker_mm, t_s)
        n = len(xyz)
        finite = np.isfinite(xyz).all(axis=1) & np.isfinite(t)
        posed = finite & (t < (-math.inf if self.pose is None else self.pose_until_s))
        phase, rate, sigma = self._model_phase(np.where(finite, t, np.nan))
        status = np.where(np.isnan(phase), int(Status.NO_PHASE), int(Status.OK))
        status = np.where(posed, status, int(Status.NO_POSE))
        place, velocity = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
        if self.pose is not None:
            poses = self.pose.matrices(t[posed])
            place[posed] = np.einsum("nij,nj->ni", poses[:, :, :3], xyz[posed]) + poses[:, :, 3]
            velocity[posed] = self.pose.velocity_mm_s(place[posed], t[posed])
        covariance, variance = self._covariance(place), np.where(posed, RIGID_SIGMA_MM**2, np.nan)
        contraction = np.where(posed, 1.0, np.nan)
        if self.warp is not None:
            pull = self.warp.pull(place[posed], t[posed])
            place[posed] -= pull.m_mm
            velocity[posed] -= np.einsum("nij,nj->ni", pull.slope, velocity[posed]) + pull.rate_mm_s
            variance[posed] = pull.variance_mm2
            contraction[posed] = self.warp.contraction(t[posed])
        return PlacesInModel(
            xyz_mm=place,
            velocity_mm_s=velocity,
            model_phase=phase,
            model_phase_rate_hz=rate,
            sigma_model_phase=sigma,
            covariance_mm2=covariance,
            wall_variance_mm2=variance,
            contraction=contraction,
            status=np.where(finite, status, int(Status.FAULT)),
        )

    def evaluate(
        self,
        evaluator: Evaluator,
        tip_tracker_mm: Any,
        t_s: Any,
        input_status: IntArray | None = None,
    ) -> ForceSamples:
        """Forces at the tool tip at some times; none where tool or pose may not be used.

        Where the phase may not be used the status is NO_PHASE: guidance has no force, and a forbidden region
        that of its worst phase, with its distance and gradient, a rate of zero and σ_d by the pose alone.

        Args:
            evaluator: fixture in the target frame of the registration.
            tip_tracker_mm: (n, 3) tool tip, tracker frame; any value where its status is not OK.
            t_s: (n,) times of these, or one for all.
            input_status: (n,) `Status` of the tool's pose; None: all OK.
        Raises:
            FrameMismatchError: the model is in another frame than the registration's target.
            InvalidInputError: shapes that do not fit.
        """
        xyz, t = _points_and_times(tip_tracker_mm, t_s)
        n = len(xyz)
        status = (
            np.full(n, int(Status.OK)) if input_status is None else np.array(input_status, dtype=np.int64)
        )
        check_shape(status, "input status", (n,))
        frame = self._pose_frames(evaluator).source
        out = np.empty((n, GUIDED_SIZE))
        guided_batch(*self._kernel_arguments(evaluator), t, xyz, status, out)
        return ForceSamples(
            frame, out[:, :3], out[:, 3], out[:, 4:7], status, out[:, 7], out[:, DISTANCE_SIGMA]
        )

    def bind(self, evaluator: Evaluator) -> partial[int]:
        """One call per servo tick, without allocation and checks, valid until the next event.

        `tick(t_s, tip_tracker_mm, input_status, out)` returns the `Status` value and fills `out` as
        `dvf_ig.kernels.pose_and_phase.guided_tick` does, vectors in the tracker frame; use it in one loop
        alone. Its `args` are for loops that run inside a kernel and never cross Python.

        Raises:
            FrameMismatchError: the model is in another frame than the registration's target.
        """
        return partial(guided_tick, *self._kernel_arguments(evaluator))

    def _kernel_arguments(self, evaluator: Evaluator) -> tuple[Any, FloatArray, Any, Any]:
        """Leading arguments of `guided_tick`; the fixture's array is a new one, which its calls write to."""
        arguments = evaluator.kernel_arguments(self._pose_frames(evaluator))
        return *arguments, self.packed[0], packed_warps(self.warp)

    def _pose_frames(self, evaluator: Evaluator) -> Rigid:
        """A map between the frames of the pose; the kernel sets its numbers."""
        if self.pose is None:
            return Rigid.identity(evaluator.model.frame, TRACKER_FRAME)
        return self.pose.end

    def _model_phase(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n,) model phase, its rate and its standard deviation; NaN where phase may not be used."""
        phases = self.phase.at_many(t_s)
        if self.retiming is None:
            return (np.full(len(t_s), np.nan),) * 3
        usable = (phases.state == int(PhaseState.LOCKED)) & ~np.isnan(phases.phi)
        phi = np.where(usable, phases.phi, np.nan)
        slope = self.retiming.slope(phi)
        return self.retiming.at(phi), slope * phases.rate_hz, slope * phases.sigma_phi

    def _covariance(self, xyz_mm: FloatArray) -> FloatArray:
        """(n, 3, 3) mm² of places by the pose: J Σ Jᵀ with J = (−[p − c]× / radius, I)."""
        n = len(xyz_mm)
        if self.covariance_mm2 is None:
            return np.full((n, 3, 3), np.nan)
        x, y, z = ((xyz_mm - self.center_mm) / HEART_RADIUS_MM).T
        jacobian = np.zeros((n, 3, 6))
        jacobian[:, 0, 1], jacobian[:, 0, 2] = z, -y
        jacobian[:, 1, 0], jacobian[:, 1, 2] = -z, x
        jacobian[:, 2, 0], jacobian[:, 2, 1] = y, -x
        jacobian[:, :, 3:] = np.eye(3)
        return np.asarray(jacobian @ self.covariance_mm2 @ np.swapaxes(jacobian, 1, 2))


def _check_covariance(covariance_mm2: FloatArray) -> None:
    """Refuse what would make a distance look more certain than it is."""
    tolerance = 1e-6 * float(np.abs(covariance_mm2).max())
    skew = float(np.abs(covariance_mm2 - covariance_mm2.T).max())
    least = float(np.linalg.eigvalsh(covariance_mm2)[0])
    if skew > tolerance or least < -tolerance:
        raise InvalidInputError(
            f"the covariance of the pose is asymmetric by {skew:.2g} mm² and its least eigenvalue is "
            f"{least:.2g} mm²; needed a symmetric matrix without negative eigenvalues"
        )


def _points_and_times(xyz_mm: Any, t_s: Any) -> tuple[FloatArray, FloatArray]:
    """(n, 3) and (n,), owned and writable: kernels are compiled for such arrays."""
    xyz = np.array(xyz_mm, dtype=np.float64, order="C")
    check_shape(xyz, "points", (None, 3))
    t = np.array(t_s, dtype=np.float64, order="C")
    if t.ndim == 0:
        t = np.full(len(xyz), t)
    check_shape(t, "times", (len(xyz),))
    return xyz, t
