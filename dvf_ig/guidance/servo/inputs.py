"""Values that a session publishes to the servo: pose and phase, hazards, margins, and their validity."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Rigid, WarpMotion, read_only_arrays
from dvf_ig.core.arrays import frozen_floats
from dvf_ig.guidance.places import Status
from dvf_ig.guidance.pose_and_phase import PoseAndPhase
from dvf_ig.guidance.supervision.hazards import Hazard
from dvf_ig.kernels.place import packed_warps
from dvf_ig.kernels.servo import layout as kernel
from dvf_ig.kernels.servo.layout import new_published

VALID_FOR_S = 0.1
"""A session publishes 30 times a second or more: three missing publications are silence."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ServoInputs:
    """One publication of the session to the servo; it holds until the next, or until it is out of date.

    Attributes:
        transform: pose and phase as functions of time.
        now_s: the session's time.
        tracker_from_device: where the device stands; frames "tracker" and "device".
        hazards: that the session knows of; the servo's supervisor adds its own.
        tool_status: `Status` of the tool's pose where that comes from a tracker; OK with a device's encoders.
        tool_axis: (3,) unit vector from the tip to the handle, frame "tracker"; 0: not known.
        margin_mm: (k,) by which each fixture is widened: a forbidden region begins earlier by it, a
            guidance's δ grows by it, which makes it softer. Empty: none.
        valid_for_s: silence after that withholds the force.
    Raises:
        InvalidInputError: margins that are negative or not finite, or more than the servo has fixtures.
    """

    transform: PoseAndPhase
    now_s: float
    tracker_from_device: Rigid
    hazards: Hazard = Hazard.NONE
    tool_status: Status = Status.OK
    margin_mm: FloatArray = field(default_factory=lambda: np.zeros(0))
    valid_for_s: float = VALID_FOR_S
    tool_axis: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        margin = frozen_floats(self.margin_mm, "margins of the fixtures", (None,))
        object.__setattr__(self, "margin_mm", margin)
        object.__setattr__(self, "tool_axis", frozen_floats(self.tool_axis, "axis of the tool", (3,)))
        if len(margin) > kernel.MAX_FIXTURES or (margin < 0.0).any():
            raise InvalidInputError(
                f"margins of {len(margin)} fixtures, the least {margin.min(initial=0.0):g} mm; needed at "
                f"most {kernel.MAX_FIXTURES}, none negative"
            )

    def packed(self, clock_s: float) -> Any:
        """(1,) INPUTS for the kernels, without the warps, which `Publication` numbers.

        Args:
            clock_s: the servo's clock at `now_s`.
        """
        packed = np.zeros(1, kernel.INPUTS)
        values = packed[0]
        values["valid_until_s"], values["clock_offset_s"] = clock_s + self.valid_for_s, clock_s - self.now_s
        values["hazards"], values["tool_status"] = self.hazards, self.tool_status
        values["tracker_from_device"] = self.tracker_from_device.matrix[:3]
        values["tool_axis"] = self.tool_axis
        values["margin_mm"][: len(self.margin_mm)] = self.margin_mm
        values["pose_and_phase"] = self.transform.packed[0]
        return packed


class Publication:
    """Memory that one publication after the other is written to; the warps get a number each."""

    def __init__(self) -> None:
        self._memory = new_published()
        self._warp: WarpMotion | None = None
        self.inputs = self._memory.inputs[0]
        self.words = self._memory.words
        self.head = self.words[: kernel.INPUT_WORDS]
        """All but the warps."""

    def set_transform(self, transform: PoseAndPhase) -> bool:
        """Take pose, phase and change of shape; returns whether the warps are others than before."""
        self.inputs["pose_and_phase"] = transform.packed[0]
        return self._set_warp(transform.warp)

    def set(self, inputs: ServoInputs, clock_s: float) -> bool:
        """Take a session's inputs; arguments as of `ServoInputs.packed`, returns as `set_transform`."""
        packed = inputs.packed(clock_s)
        packed["warps_number"] = self.inputs["warps_number"]
        self._memory.inputs[:] = packed
        return self._set_warp(inputs.transform.warp)

    def _set_warp(self, warp: WarpMotion | None) -> bool:
        if warp is None or warp is self._warp:
            return False
        self._warp = warp
        self._memory.warps[:] = packed_warps(warp)
        self.inputs["warps_number"] += 1
        return True
