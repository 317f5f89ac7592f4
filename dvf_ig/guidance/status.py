"""Status of a force: why it was, or was not, produced."""

from enum import IntEnum

from dvf_ig.kernels import status as code


class Status(IntEnum):
    """Anything but OK goes with zero force, except that walls of the worst phase remain at NO_PHASE."""

    OK = code.OK
    OUT_OF_VOLUME = code.OUT_OF_VOLUME
    """The tool is outside the box in which the model is defined: unprotected."""
    NO_PHASE = code.NO_PHASE
    """The cardiac phase is not valid: the phase clock is not locked. Guidance gives no force; forbidden
    regions are those of the worst phase (`dvf_ig.kernels.worst_phase`)."""
    NO_POSE = code.NO_POSE
    """The patient is not registered, or the registration must not be used."""
    STALE_TOOL = code.STALE_TOOL
    """The tool's pose is too old, or the tracker does not see it."""
    FAULT = code.FAULT
    """The input or the output was not finite."""
