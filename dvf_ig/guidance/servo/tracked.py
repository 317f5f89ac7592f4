"""The servo in a session's own time: the force at every state, for a tool that a tracker sees."""

import math
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.guidance.device import COMMON_DEVICE, DeviceLimits
from dvf_ig.guidance.fixtures import Fixtures
from dvf_ig.guidance.places import Status
from dvf_ig.guidance.pose_and_phase import PoseAndPhase
from dvf_ig.guidance.supervision.hazards import Hazard
from dvf_ig.guidance.supervision.supervisor import RearmAnswer, SupervisorState
from dvf_ig.kernels.servo.layout import new_scratch
from dvf_ig.kernels.servo.supervision import rearm
from dvf_ig.kernels.servo.tick import withhold
from dvf_ig.kernels.servo.tracked import TRACKED, tick_until

from .bound import REARM_ANSWERS, bind_fixtures
from .inputs import VALID_FOR_S, Publication
from .options import ServoOptions
from .record import ServoTick


class TrackedServo:
    """The ticks of `Servo`, run up to each publication; the frame of the forces is "tracker".

    The same publications at the same times give the same forces, bit by bit. Between two of them ticks come a
    period apart; a session that publishes nothing for VALID_FOR_S is silent to it.

    Args:
        fixtures: on the patient's model.
        limits: of the device that renders the force; the stiffness gives the slew limit.
        options: rate, damping, passivity.
        latch_after_s: without a publication for longer, nothing that was felt since is known: the next force
            is zero and latched, by MISSED_DEADLINES. Before the first force nothing was felt, and the servo
            begins again, as while a new machine compiles. Infinite for a session that is asked rarely.
    Raises:
        InvalidInputError: as `bind_fixtures`.
    """

    def __init__(
        self,
        fixtures: Fixtures,
        *,
        limits: DeviceLimits = COMMON_DEVICE,
        options: ServoOptions = ServoOptions(),  # noqa: B008  frozen
        latch_after_s: float = math.inf,
    ) -> None:
        self._latch_after_s, self._stepped_s = latch_after_s, math.inf
        self._bound = bind_fixtures(fixtures, limits, options, latency_s=0.0)
        self._fixtures, self._felt = len(fixtures.parts), False
        self._scratch = new_scratch(self._fixtures)
        self._tool: Any = np.zeros(1, TRACKED)[0]
        self._tip_mm, self._velocity = np.zeros(3), np.zeros(3)
        self._publication = Publication()
        self._publication.inputs["tracker_from_device"] = np.eye(3, 4)
        self._transform: PoseAndPhase | None = None
        self._margin_mm: FloatArray | None = None

    def step(
        self,
        now_s: float,
        transform: PoseAndPhase,
        hazards: Hazard,
        tool_status: Status,
        margin_mm: FloatArray,
        tip: tuple[FloatArray, FloatArray] | None,
        axis: FloatArray | None = None,
    ) -> ServoTick:
        """Publish what a session knows at a time not before the last; the tick at that moment.

        Args:
            transform, hazards, tool_status, margin_mm: as of `ServoInputs`; neither array nor transform
                changes after it was given.
            tip: (3,) mm and (3,) mm/s of the tool now, frame "tracker"; None if it is not known.
            axis: (3,) from the tip to the handle, frame "tracker"; None: as before.
        """
        published, tip_seen = self._publication.inputs, tip is not None
        published["valid_until_s"] = now_s + VALID_FOR_S
        published["hazards"], published["tool_status"] = hazards, tool_status
        if transform is not self._transform:
            self._transform = transform
            self._publication.set_transform(transform)
        if margin_mm is not self._margin_mm:
            self._margin_mm, published["margin_mm"][: len(margin_mm)] = margin_mm, margin_mm
        if axis is not None:
            published["tool_axis"] = axis
        if tip is not None:
            self._tip_mm[:], self._velocity[:] = tip
        silent = now_s - self._stepped_s > self._latch_after_s
        if silent and not self._felt and self._scratch.row["state"][0] != SupervisorState.LATCHED:
            self._scratch, self._tool = new_scratch(self._fixtures), np.zeros(1, TRACKED)[0]
        tick_until(
            self._bound,
            self._scratch,
            self._tool,
            self._publication.words,
            self._tip_mm,
            self._velocity,
            tip_seen,
            now_s,
        )
        if silent and self._felt:
            withhold(self._bound, self._scratch, now_s)
        self._stepped_s = now_s
        self._felt = self._felt or bool(self._scratch.row["sent_n"].any())
        return ServoTick(self._scratch.row)

    @property
    def model_phase(self) -> float:
        """Phase of the model's cycle at the last step; NaN if the phase is not locked."""
        return float(self._tool["model_phase"])

    def rearm(self, t_s: float) -> RearmAnswer:
        """An operator's request to leave LATCHED at a time not before the last tick, judged by that tick."""
        settings = self._bound.settings[0]
        memory = self._scratch.memory[0]["supervision"]
        return REARM_ANSWERS[rearm(memory, settings["limits"], settings["hazards"], t_s)]
