"""One tick of the servo in readable form, of a heart that has kept its shape; tests hold the kernel to it.

tests/guidance/test_warp.py holds what a warp does to the kernel's forces to `Evaluator` and `PathFixture`.
"""

import math
from typing import Any

import numpy as np
from readable_phase_loss import PhaseLoss
from readable_supervisor import Supervisor

from dvf_ig.core import FloatArray, IntArray, Rigid
from dvf_ig.guidance.device import DeviceLimits
from dvf_ig.guidance.evaluator import ForceSamples
from dvf_ig.guidance.fixtures import Fixtures, FixtureSet, composed_force, unfelt_outside
from dvf_ig.guidance.places import Status
from dvf_ig.guidance.servo import ServoInputs, ServoOptions
from dvf_ig.guidance.servo.bound import tick_constants
from dvf_ig.guidance.supervision.hazards import Hazard, hazard_of, withholding
from dvf_ig.guidance.supervision.supervisor import SupervisedForce, SupervisorState
from dvf_ig.guidance.targets import PathFixture

NO_PARTS = (np.zeros((0, 3)), np.zeros((0, 3)))


class PassivityObserver:
    """Energy that holding, latency and quantisation have made, and the damping that takes it back.

    `dvf_ig.kernels.servo.passivity` explains the formula and is the kernel's form.

    Attributes:
        residual_mj: made and not yet taken back; given_mj: work on the hand; by_surface_mj: of that, by the
            surface's motion.
    """

    def __init__(self, delay_ticks: int, largest_damping: float) -> None:
        self._delay, self._largest = delay_ticks, largest_damping
        self.residual_mj = self.given_mj = self.by_surface_mj = 0.0
        self._last: tuple[FloatArray, FloatArray] | None = None
        self._surface = np.zeros(3)
        self._parts = self._now = NO_PARTS
        self._sent: list[FloatArray] = []
        self._sent_parts: list[FloatArray] = []

    def observe(
        self,
        xyz_mm: FloatArray,
        field_n: FloatArray,
        dt_s: float,
        *,
        following: bool,
        parts: tuple[FloatArray, FloatArray] = NO_PARTS,
    ) -> None:
        """Account for the period that has just passed.

        Args:
            parts: (k, 3) N shares of the field, and (k, 3) mm/s of their surfaces; (0, 3) if all is one.
        """
        self._parts, self._now = self._now, parts
        if self._last is not None:
            at = len(self._sent) - 1 - self._delay
            felt = self._sent[at] if at >= 0 else np.zeros(3)
            moved, surface = xyz_mm - self._last[0], self._surface * dt_s
            ideal = 0.5 * (field_n + self._last[1])
            by_surface, by_ideal = float(felt @ surface), float(ideal @ surface)
            before, velocity = self._parts
            if len(before):
                shares = (
                    self._sent_parts[at] if at >= 0 and len(self._sent_parts[at]) else np.zeros_like(before)
                )
                after = parts[0] if len(parts[0]) else before
                by_surface = float((shares * velocity).sum() * dt_s + (felt - shares.sum(axis=0)) @ surface)
                by_ideal = float((0.5 * (before + after) * velocity).sum() * dt_s)
            self.given_mj += float(felt @ moved)
            self.by_surface_mj += by_surface
            if following:
                made = float((felt - ideal) @ moved) - by_surface + by_ideal
                self.residual_mj = max(0.0, self.residual_mj + made)
        self._last = (xyz_mm.copy(), field_n.copy())

    def damping(self, speed: FloatArray, surface: FloatArray, period_s: float) -> FloatArray:
        """(3,) force of the controller for the period to come."""
        self._surface = surface.copy()
        relative = speed - surface
        square = float(relative @ relative)
        if self._largest <= 0.0 or self.residual_mj <= 0.0 or square <= 0.0:
            return np.zeros(3)
        return np.asarray(-min(self._largest, self.residual_mj / (square * period_s)) * relative)

    def note(self, sent_n: FloatArray) -> None:
        self._sent.append(sent_n.copy())
        self._sent_parts.append(self._now[0])

    def forget_residual(self) -> None:
        """Nothing is sent any more."""
        self.residual_mj = 0.0


class ReadableTick:
    """Ticks in Python; arguments as of `Servo`, with the device's latency. For tests: no speed, no thread."""

    def __init__(
        self, fixtures: Fixtures, limits: DeviceLimits, options: ServoOptions, latency_s: float
    ) -> None:
        self._set: FixtureSet = fixtures.options
        self._parts, self._far_outside = fixtures.parts, fixtures.far_outside
        self._c, self._options = tick_constants(fixtures, options, latency_s), options
        self._supervisor, self._loss = Supervisor(limits, walls=fixtures.walls), PhaseLoss()
        self._forbidden = [one.forbidden for one in fixtures.options.fixtures]
        self._on_heart = [i for i, one in enumerate(fixtures.options.fixtures) if one.on_model]
        self.observer = PassivityObserver(self._c.delay_ticks, self._c.largest_damping)
        self._last: tuple[float, FloatArray] | None = None
        self._speed = np.zeros(3)
        self._following, self._shares = False, NO_PARTS
        self.distance_mm = math.nan
        """Of the primary fixture in the last step."""

    def step(self, t_s: float, xyz_device_mm: FloatArray, inputs: ServoInputs) -> SupervisedForce:
        """One tick at the session's time `t_s`; the force sent, tracker frame."""
        if inputs.transform.warp is not None:
            raise ValueError("the readable tick knows no change of the heart's shape")
        c = self._c
        dt_s = c.period_s if self._last is None else t_s - self._last[0]
        xyz = inputs.tracker_from_device.apply_array(xyz_device_mm[None])[0]
        if self._last is not None:
            self._speed = self._speed + c.speed_share * ((xyz - self._last[1]) / dt_s - self._speed)
        self._last = (t_s, xyz)
        hazards = inputs.hazards
        silent = t_s > inputs.now_s + inputs.valid_for_s
        status = Status.NO_POSE if silent else inputs.tool_status
        if status == Status.OK and hazards & Hazard.NO_PHASE:
            status = Status.NO_PHASE
        hazards |= Hazard.SESSION_SILENT if silent else Hazard.NONE
        ahead = xyz + (c.lead_s * self._speed if self._options.predict_tool else 0.0)
        field_n, wanted_n, surface, status = self._forces(ahead, t_s + c.lead_s, dt_s, inputs, status)
        met = status in (Status.FAULT, Status.OUT_OF_VOLUME, Status.UNSEEN)
        if met or not hazards & withholding(any(self._forbidden)):
            hazards |= hazard_of(status)
        parts = self._shares if status == Status.OK and self._loss.share == 0.0 else NO_PARTS
        sizes = np.linalg.norm(parts[0], axis=1)
        if sizes.sum() > 0.0:
            surface = sizes @ parts[1] / sizes.sum()
        self.observer.observe(xyz, field_n, dt_s, following=self._following, parts=parts)
        if math.isfinite(self.distance_mm):
            wanted_n = wanted_n + self.observer.damping(self._speed, surface, c.period_s)
        length = float(np.linalg.norm(wanted_n))
        if length > c.cap_n:
            wanted_n = wanted_n * (c.cap_n / length)
        if self.observer.residual_mj > self._options.residual_limit_mj:
            hazards |= Hazard.ENERGY
        sent = self._supervisor.step(t_s, wanted_n, hazards)
        if sent.state is SupervisorState.LATCHED:
            self.observer.forget_residual()
        self.observer.note(sent.force_n)
        self._following = sent.state is SupervisorState.OK or (
            sent.state is SupervisorState.DEGRADED and not self._supervisor.rising
        )
        return sent

    def _forces(
        self, xyz: FloatArray, t_s: float, dt_s: float, inputs: ServoInputs, status: Status
    ) -> tuple[FloatArray, FloatArray, FloatArray, Status]:
        """The fixtures' force, the same with relative damping, the surface's velocity, the status."""
        nothing = np.zeros(3)
        each = self._each(xyz, t_s, inputs, status)
        statuses = [Status(int(one.status[0])) for one in each]
        refused = [one for one in statuses if one not in (Status.OK, Status.NO_PHASE)]
        found = refused[0] if refused else max(statuses)
        place = inputs.transform.at(xyz[None], t_s)
        self._loss.step(dt_s, found, float(place.model_phase[0]))
        self.distance_mm, self._shares = math.nan, NO_PARTS
        if found != Status.OK and (found != Status.NO_PHASE or not any(self._forbidden)):
            return nothing, nothing, nothing, found
        field_n = self._crossed(self._composed(each), xyz, t_s, inputs, found)
        near = [
            i
            for i, one in enumerate(each)
            if np.isfinite(one.distance_mm[0]) and (found == Status.OK or self._forbidden[i])
        ]
        if not near:
            if len(self._on_heart) < len(each):
                self._shares = (np.zeros((len(each), 3)), np.zeros((len(each), 3)))
            return field_n, field_n, nothing, found
        self._shares = self._share_out(each, place, t_s, inputs)
        first, primary = near[0], each[near[0]]
        self.distance_mm = float(primary.distance_mm[0])
        gradient = primary.gradient[0]
        rate = self._rate(first, primary, place, t_s, inputs, found)
        norm = float(np.linalg.norm(gradient))
        pushed = field_n + self._options.feed_forward.force(gradient, rate, self._speed)
        return field_n, pushed, -rate / norm * gradient / norm, found

    def _rate(
        self, i: int, samples: ForceSamples, place: Any, t_s: float, inputs: ServoInputs, found: Status
    ) -> float:
        """∂d/∂t of fixture `i`, mm/s."""
        rotation = inputs.transform.pose.at(t_s).rotation if inputs.transform.pose is not None else np.eye(3)
        per_cycle, part = samples.rate_mm_per_cycle, self._parts[i]
        if isinstance(part, PathFixture):
            per_cycle = np.array([part.target.rate(place.xyz_mm[0], float(place.model_phase[0]))])
        by_phase = per_cycle * np.nan_to_num(place.model_phase_rate_hz)
        by_pose = np.einsum("ni,ni->n", (rotation @ samples.gradient[0])[None], place.velocity_mm_s)
        return float((by_pose + (by_phase if found == Status.OK else 0.0))[0])

    def _share_out(
        self, each: list[ForceSamples], place: Any, t_s: float, inputs: ServoInputs
    ) -> tuple[FloatArray, FloatArray]:
        """Each fixture's share of the composed force, and its surface's velocity; one surface has none."""
        if len(self._on_heart) == len(each):
            return NO_PARTS
        forces = np.array([one.force_n[0] for one in each])
        composed = composed_force(self._set, forces)
        forbidden = np.array(self._forbidden)
        pushed, sizes = forces[forbidden].sum(axis=0), np.linalg.norm(forces, axis=1) * ~forbidden
        kept = float(pushed @ composed.forbidden_n) / float(pushed @ pushed) if pushed.any() else 0.0
        guided = sizes / sizes.sum() if sizes.sum() > 0.0 else sizes
        shares = np.where(forbidden[:, None], kept * forces, guided[:, None] * composed.guidance_n)
        velocity = np.zeros_like(shares)
        for i, own in enumerate(each):
            one = each[self._on_heart[0]] if i in self._on_heart else own
            if np.isfinite(one.distance_mm[0]):
                g = one.gradient[0]
                velocity[i] = -self._rate(i, one, place, t_s, inputs, Status.OK) / (g @ g) * g
        return shares, velocity

    def _each(self, xyz: FloatArray, t_s: float, inputs: ServoInputs, status: Status) -> list[ForceSamples]:
        transform, given = inputs.transform, np.array([int(status)])
        place = transform.at(xyz[None], t_s)
        known = place.status if status == Status.OK else given
        pose = Rigid.identity("mr", "tracker") if transform.pose is None else transform.pose.at(t_s)
        return [
            part.force_through(pose, xyz[None], place.model_phase, known)
            if isinstance(part, PathFixture)
            else self._near(i, transform.evaluate(part, xyz[None], t_s, given), known)
            for i, part in enumerate(self._parts)
        ]

    def _near(self, i: int, samples: ForceSamples, known: IntArray) -> ForceSamples:
        return unfelt_outside(samples, known) if self._far_outside[i] else samples

    def _composed(self, each: list[ForceSamples]) -> FloatArray:
        return composed_force(self._set, np.array([one.force_n[0] for one in each])).force_n

    def _crossed(
        self, force_n: FloatArray, xyz: FloatArray, t_s: float, inputs: ServoInputs, found: Status
    ) -> FloatArray:
        """The force, mixed with that of the last known phase, or with the walls of the worst one."""
        share, pose = self._loss.share, inputs.transform.pose
        if not any(self._forbidden) or pose is None:
            return force_n
        if found == Status.OK and share > 0.0:
            worst = self._composed(self._each(xyz, t_s, inputs, Status.NO_PHASE))
            return (1.0 - share) * force_n + share * worst
        if found == Status.NO_PHASE and share < 1.0:
            phase = self._loss.last_phase
            held = [part.force_through(pose.at(t_s), xyz[None], phase) for part in self._parts]
            return (1.0 - share) * self._composed(held) + share * force_n
        return force_n
