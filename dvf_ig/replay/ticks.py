"""States of a session at every tick of a replay, as arrays over time."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, PhaseTrack, read_only_arrays
from dvf_ig.guidance import PoseAndPhase, Status, SupervisorState
from dvf_ig.session import GuidanceState

POSE_STEP_S = 0.05
"""Step between thinned poses, which move steadily, or with the breath."""
CORNER = 1e-4
"""Change of a pose's step from tick to tick, mm or 1, above which that tick is kept."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Ticks:
    """One row a tick; vectors in frame "tracker".

    Attributes:
        phase: phase with its state; its times are those of the ticks.
        model_phase: (n,) place in the model's cycle; NaN where the phase is not locked.
        mr_from_tracker: (n, 3, 4) the pose through which the force came; NaN without one.
        pose_age_s: (n,) time since a beat confirmed the pose; infinite before the first.
        pose_bound_mm: (n,) 95 % bound on the RMS error, see `PoseEstimate`; NaN before the first.
        tip_tracker_mm: (n, 3) predicted tip; NaN where the tool is not known.
        force_n: (n, 3) sent by the supervisor; wanted_n: of the fixtures.
        distance_mm: (n,) signed distance of the primary fixture, at NO_PHASE of the first wall at its worst
            phase; else NaN.
        margin_mm: (n,) by which the primary fixture is widened.
        breath_phase, breath_mm, breath_state: (n,) as in `BreathMoment`.
        status: (n,) `Status` of the fixtures.
        supervisor: (n,) `SupervisorState`; hazards: (n,) bits of `Hazard`.
    """

    phase: PhaseTrack
    model_phase: FloatArray
    mr_from_tracker: FloatArray
    pose_age_s: FloatArray
    pose_bound_mm: FloatArray
    tip_tracker_mm: FloatArray
    force_n: FloatArray
    wanted_n: FloatArray
    distance_mm: FloatArray
    margin_mm: FloatArray
    breath_phase: FloatArray
    breath_mm: FloatArray
    breath_state: IntArray
    status: IntArray
    supervisor: IntArray
    hazards: IntArray

    def __len__(self) -> int:
        return len(self.status)

    @property
    def t_s(self) -> FloatArray:
        """(n,)"""
        return self.phase.t_s

    @property
    def valid(self) -> BoolArray:
        """(n,) ticks with tracked tool, locked phase, a usable pose and the tool inside the model's box."""
        return np.asarray(self.status == int(Status.OK))

    @property
    def guided(self) -> BoolArray:
        """(n,) ticks in which the supervisor follows the fixtures: it neither fades nor is latched."""
        return np.asarray(self.supervisor <= int(SupervisorState.DEGRADED))

    def thinned_poses(self) -> tuple[FloatArray, FloatArray]:
        """Thin poses to one every POSE_STEP_S and those at which motion begins or ends, without repetitions.

        Returns:
            (m,) times; (m, 3, 4) poses.
        """
        step = max(1, round(POSE_STEP_S / float(np.median(np.diff(self.t_s)))))
        used = np.isfinite(self.mr_from_tracker[:, 0, 0])
        edges = np.flatnonzero(used[1:] != used[:-1])
        bend = np.abs(np.diff(self.mr_from_tracker, n=2, axis=0)).max(axis=(1, 2), initial=0.0)
        corners = np.flatnonzero(np.nan_to_num(bend) > CORNER) + 1
        ends = [0, len(self) - 1]
        rows = np.unique(np.concatenate([np.arange(0, len(self), step), edges, edges + 1, corners, ends]))
        poses = self.mr_from_tracker[rows]
        same = (np.nan_to_num(poses[1:]) == np.nan_to_num(poses[:-1])).all(axis=(1, 2))
        needed = np.concatenate([[True], ~(same[:-1] & same[1:]), [True]])
        return self.t_s[rows[needed]], poses[needed]


class TickRecorder:
    """Collects states, one for each of (n,) tick times."""

    def __init__(self, t_s: FloatArray) -> None:
        n = len(t_s)
        self._t_s = t_s
        self._tip, self._force, self._wanted = np.full((n, 3), np.nan), np.zeros((n, 3)), np.zeros((n, 3))
        self._model_phase, self._distance, self._age = np.empty(n), np.empty(n), np.empty(n)
        self._margin, self._bound = np.zeros(n), np.empty(n)
        self._breath = np.empty((n, 2))
        self._codes = np.empty((n, 4), dtype=np.int64)
        self._transforms: list[tuple[int, PoseAndPhase]] = []

    def add(self, i: int, state: GuidanceState) -> None:
        """The state at tick i."""
        if not self._transforms or self._transforms[-1][1] is not state.transform:
            self._transforms.append((i, state.transform))
        if not state.tool.hazard:
            self._tip[i] = state.tool.tip_tracker_mm
        self._force[i], self._wanted[i] = state.force_n, state.wanted_n
        self._model_phase[i], self._distance[i] = state.model_phase, state.distance_mm
        self._age[i], self._margin[i] = state.pose_age_s, state.margin_mm[0]
        self._bound[i] = state.pose_bound_mm
        breath = state.breath
        self._breath[i] = breath.phase, breath.displacement_mm
        self._codes[i] = *state.tick.codes, breath.state

    def finish(self) -> Ticks:
        """All ticks; phase and pose are read from the transforms that held."""
        phase, poses = np.empty((4, len(self._t_s))), np.full((len(self._t_s), 3, 4), np.nan)
        ends = [*(first for first, _ in self._transforms[1:]), len(self._t_s)]
        for (first, transform), end in zip(self._transforms, ends, strict=True):
            here = slice(first, end)
            read = transform.phase.at_many(self._t_s[here])
            phase[:, here] = read.phi, read.sigma_phi, read.rr_s, read.state
            if transform.pose is not None:
                used = self._t_s[here] < transform.pose_until_s
                poses[here][used] = transform.pose.matrices(self._t_s[here][used])
        return Ticks(
            phase=PhaseTrack(self._t_s, phase[0], phase[1], phase[2], phase[3].astype(np.int64)),
            model_phase=self._model_phase,
            mr_from_tracker=poses,
            pose_age_s=self._age,
            pose_bound_mm=self._bound,
            tip_tracker_mm=self._tip,
            force_n=self._force,
            wanted_n=self._wanted,
            distance_mm=self._distance,
            margin_mm=self._margin,
            breath_phase=self._breath[:, 0],
            breath_mm=self._breath[:, 1],
            breath_state=self._codes[:, 3],
            status=self._codes[:, 0],
            supervisor=self._codes[:, 1],
            hazards=self._codes[:, 2],
        )
