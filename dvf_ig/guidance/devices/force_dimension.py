"""Haptic devices of Force Dimension (omega, delta, sigma, lambda, Novint Falcon), by their own library.

The same library that the package forcedimension-core wraps, found by the same variable; its functions are
called from the servo's thread without Python, so the package itself is not needed.
"""

import ctypes
import os
import platform
from pathlib import Path

import numpy as np

from dvf_ig.guidance.device import DeviceLimits
from dvf_ig.kernels.servo import force_dimension as kernel

from .vendor_library import VendorLibraryError, address_of, load_vendor_library

VENDOR = "the Force Dimension SDK"
LIBRARY = "libdhd.so"
FUNCTIONS = (
    "dhdOpen",
    "dhdClose",
    "dhdGetPosition",
    "dhdGetButton",
    "dhdSetForce",
    "dhdEnableForce",
    "dhdSetWatchdog",
    "dhdErrorGetLastStr",
)
ADVICE = (
    "install the SDK from forcedimension.com and set FORCEDIM_SDK to its folder (forcedimension-core wants "
    "it too), or give the path of libdhd.so"
)
FASTEST_HZ = 4000.0
"""Rate at which its controller exchanges positions and forces (SDK documentation)."""
LATENCY_S = 0.001
"""A USB frame from command to motor, and one from encoder to reading, half a millisecond each on average; not
measured here."""


WATCHDOG_STEP_S = 125e-6
WATCHDOG_STEPS = 120
"""The device's own watchdog ends the force 15 ms after the last command, also after the program was killed:
later than the servo's, which has latched by then."""


class ForceDimensionDevice:
    """The first device that is free.

    Args:
        path: of libdhd.so; None: below FORCEDIM_SDK, or where the system's loader finds it.
        latency_s: from a force sent to the force felt, and from a position to its reading, together.
    Raises:
        VendorLibraryError: no library, or no device that opens.
    """

    name = "Force Dimension device"
    rate_hz = FASTEST_HZ
    limits: DeviceLimits | None = None

    def __init__(self, path: str | Path | None = None, *, latency_s: float = LATENCY_S) -> None:
        self.latency_s = latency_s
        self._library = load_vendor_library(VENDOR, _places(), FUNCTIONS, ADVICE, path)
        self._library.dhdErrorGetLastStr.restype = ctypes.c_char_p
        self._id = int(self._library.dhdOpen())
        if self._id < 0:
            raise VendorLibraryError(
                f"no Force Dimension device opened: {self._error()}; connect one and switch it on"
            )
        self.ends_force_after_s: float | None = None
        self.enable_force()
        self.functions = np.array([kernel.read_force_dimension.address, kernel.write_force_dimension.address])
        self.context = np.zeros(kernel.CONTEXT_SIZE, dtype=np.int64)
        self.context[kernel.GET_POSITION] = address_of(self._library, "dhdGetPosition")
        self.context[kernel.SET_FORCE] = address_of(self._library, "dhdSetForce")
        self.context[kernel.GET_BUTTON] = address_of(self._library, "dhdGetButton")
        self.context[kernel.DEVICE] = self._id

    def enable_force(self) -> None:
        """Switch forces on, and the device's own watchdog, which switches them off when it expires."""
        if self._library.dhdEnableForce(ctypes.c_ubyte(1), ctypes.c_byte(self._id)) < 0:
            reason = self._error()
            self.close()
            raise VendorLibraryError(f"the Force Dimension device does not enable forces: {reason}")
        watched = self._library.dhdSetWatchdog(ctypes.c_ubyte(WATCHDOG_STEPS), ctypes.c_byte(self._id)) >= 0
        self.ends_force_after_s = WATCHDOG_STEPS * WATCHDOG_STEP_S if watched else None

    @property
    def pressed(self) -> bool:
        """State of its first button, as the servo read it last."""
        return int(self.context[kernel.PRESSED]) > 0

    def close(self) -> None:
        """Switch forces off and let go of the device; a second time does nothing."""
        if self._id >= 0:
            self._library.dhdEnableForce(ctypes.c_ubyte(0), ctypes.c_byte(self._id))
            self._library.dhdClose(ctypes.c_byte(self._id))
            self._id = -1

    def _error(self) -> str:
        said = self._library.dhdErrorGetLastStr()
        return said.decode() if said else "no reason given"


def _places() -> list[str]:
    sdk = os.environ.get("FORCEDIM_SDK")
    below = f"lib/release/lin-{platform.machine()}-gcc/{LIBRARY}"
    return ([str(Path(sdk) / below)] if sdk else []) + [LIBRARY]
