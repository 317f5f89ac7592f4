"""Interface of a haptic device to the servo."""

from typing import Any, Protocol


class HapticDevice(Protocol):
    """An open haptic device, driven by two C functions so that no tick waits for Python.

    Attributes:
        name: for messages.
        functions: (2,) int64 addresses of read and write (`dvf_ig.kernels.servo.device_call`): positions in
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
