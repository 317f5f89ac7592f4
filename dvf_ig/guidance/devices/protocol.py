"""Interface of a haptic device to the servo."""

from typing import Any, Protocol

from dvf_ig.guidance.device import DeviceLimits


class HapticDevice(Protocol):
    """An open haptic device, driven by two C functions so that no tick waits for Python.

    Attributes:
        name: for messages.
        functions: (2,) int64 addresses of read and write (`dvf_ig.kernels.servo.foreign`): positions in
            mm and forces in N, in the frame "device".
        context: int64 array handed to both; the device owns it.
        latency_s: from a force that is sent to the force that is felt, and from a position to its reading,
            together; beyond the servo's period.
    """

    @property
    def name(self) -> str: ...

    @property
    def functions(self) -> Any: ...

    @property
    def context(self) -> Any: ...

    @property
    def latency_s(self) -> float: ...

    def close(self) -> None:
        """Switch forces off and let go of the device; a second time does nothing."""


class HeldDevice(HapticDevice, Protocol):
    """Haptic device that a person holds: it also states its limits and has a button.

    Attributes:
        rate_hz: rate at which a servo drives it.
        limits: what it can render; None if its library does not say.
        ends_force_after_s: time after the last command at which the device itself ends the force, also after
            a killed process; None if it does not.
        pressed: state of its button.
    """

    @property
    def rate_hz(self) -> float: ...

    @property
    def limits(self) -> DeviceLimits | None: ...

    @property
    def ends_force_after_s(self) -> float | None: ...

    @property
    def pressed(self) -> bool: ...

    def enable_force(self) -> None:
        """Switch forces on again after its own watchdog has expired; while a servo sends commands."""
