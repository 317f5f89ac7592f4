"""Haptic devices of 3D Systems (Touch, Touch X, PHANToM) by the HD library of OpenHaptics.

The same library that the package pyOpenHaptics wraps; its functions are called without Python, so the package
itself is not needed.
"""

import ctypes
import weakref
from pathlib import Path
from typing import ClassVar

import numpy as np

from dvf_ig.core import IntArray
from dvf_ig.guidance.device import MM_PER_M, DeviceLimits
from dvf_ig.kernels.servo import openhaptics as kernel

from .vendor_library import VendorLibraryError, address_of, load_vendor_library

VENDOR = "OpenHaptics"
LIBRARY = "libHD.so"
FUNCTIONS = (
    "hdInitDevice",
    "hdDisableDevice",
    "hdEnable",
    "hdDisable",
    "hdStartScheduler",
    "hdStopScheduler",
    "hdScheduleAsynchronous",
    "hdUnschedule",
    "hdBeginFrame",
    "hdEndFrame",
    "hdGetDoublev",
    "hdGetIntegerv",
    "hdSetDoublev",
    "hdGetError",
)
ADVICE = (
    "install OpenHaptics and the Touch device driver from 3D Systems (pyOpenHaptics wants them too), or give "
    "the path of libHD.so"
)
HD_FORCE_OUTPUT = 0x4000
HD_NOMINAL_MAX_STIFFNESS = 0x2602
HD_NOMINAL_MAX_CONTINUOUS_FORCE = 0x2604
HD_INVALID_HANDLE = 0xFFFFFFFF
HD_MAX_SCHEDULER_PRIORITY = 0xFFFF
LATENCY_S = 0.0015
"""The scheduler hands positions and forces over at its own ticks, half of one late on average each, beside
the link's; not measured here."""

LOST_AFTER_S = 0.02
SCHEDULER_HZ = 1000.0


class _ErrorInfo(ctypes.Structure):
    _fields_: ClassVar = [
        ("error_code", ctypes.c_uint),
        ("internal_code", ctypes.c_int),
        ("handle", ctypes.c_uint),
    ]


class OpenHapticsDevice:
    """A device by its name in the driver's configuration.

    Args:
        configured: its name; None: the default device.
        path: of libHD.so; None: where the system's loader finds it.
        latency_s: from a force sent to the force felt, and from a position to its reading, together.
        lost_after_s: without a new position from the scheduler for so long the device is lost.
    Raises:
        VendorLibraryError: no library, or a device that does not open.
    """

    rate_hz = SCHEDULER_HZ
    ends_force_after_s: float | None = None
    """No function of the library states or sets it."""

    def __init__(
        self,
        configured: str | None = None,
        path: str | Path | None = None,
        *,
        latency_s: float = LATENCY_S,
        lost_after_s: float = LOST_AFTER_S,
    ) -> None:
        self.name = f"OpenHaptics device '{configured or 'default'}'"
        self.latency_s = latency_s
        library = load_vendor_library(VENDOR, [LIBRARY], FUNCTIONS, ADVICE, path)
        _declare(library)
        handle = library.hdInitDevice(configured.encode() if configured is not None else None)
        code = library.hdGetError().error_code
        if handle == HD_INVALID_HANDLE or code != 0:
            raise VendorLibraryError(
                f"{self.name} does not open (HD error 0x{code:04X}); connect it, and set it up with the "
                "driver's Touch_Setup and Touch_Diagnostic"
            )
        self.limits = _limits(library, self.name)
        self.context = np.zeros(kernel.CONTEXT_SIZE, dtype=np.int64)
        self.functions = np.array([kernel.read_openhaptics.address, kernel.write_openhaptics.address])
        self.context[kernel.HANDLE] = handle
        self.context[kernel.LOST_AFTER_NS] = round(1e9 * lost_after_s)
        self.context[kernel.SEEN_POSITION] = self.context[kernel.SEEN_FORCE] = -1
        for at, name in (
            (kernel.BEGIN_FRAME, "hdBeginFrame"),
            (kernel.END_FRAME, "hdEndFrame"),
            (kernel.GET_DOUBLES, "hdGetDoublev"),
            (kernel.SET_DOUBLES, "hdSetDoublev"),
            (kernel.GET_INTEGERS, "hdGetIntegerv"),
            (kernel.GET_ERROR, "hdGetError"),
        ):
            self.context[at] = address_of(library, name)
        library.hdEnable(HD_FORCE_OUTPUT)
        scheduled = library.hdScheduleAsynchronous(
            kernel.exchange.address, self.context.ctypes.data, HD_MAX_SCHEDULER_PRIORITY
        )
        # the driver's thread writes into the context: a device that is dropped stops it first
        self._let_go = weakref.finalize(self, _let_go, library, handle, scheduled, self.context)
        library.hdStartScheduler()

    @property
    def error_code(self) -> int:
        """The first HD error that the scheduler's callback met; 0 none."""
        return int(self.context[kernel.ERROR])

    def enable_force(self) -> None:
        """No watchdog switches its forces off."""

    @property
    def pressed(self) -> bool:
        """Whether any of its buttons is pressed."""
        return int(self.context[kernel.BUTTONS]) != 0

    def close(self) -> None:
        """Switch forces off and let go of the device; a second time does nothing."""
        self._let_go()


def _let_go(library: ctypes.CDLL, handle: int, scheduled: int, context: IntArray) -> None:
    """Stop the scheduler, whose callback wrote to `context` until now."""
    library.hdStopScheduler()
    library.hdUnschedule(scheduled)
    library.hdDisable(HD_FORCE_OUTPUT)
    library.hdDisableDevice(handle)


def _limits(library: ctypes.CDLL, name: str) -> DeviceLimits | None:
    """Limits that the driver states (N/mm and N); None if it states none."""
    stated = []
    for parameter in (HD_NOMINAL_MAX_STIFFNESS, HD_NOMINAL_MAX_CONTINUOUS_FORCE):
        value = ctypes.c_double(0.0)
        library.hdGetDoublev(parameter, ctypes.byref(value))
        stated.append(value.value)
    if library.hdGetError().error_code != 0 or not all(value > 0.0 for value in stated):
        return None
    stiffness, force_n = stated
    return DeviceLimits(
        rate_hz=SCHEDULER_HZ, stiffness_n_per_m=MM_PER_M * stiffness, continuous_force_n=force_n, name=name
    )


def _declare(library: ctypes.CDLL) -> None:
    library.hdInitDevice.argtypes, library.hdInitDevice.restype = [ctypes.c_char_p], ctypes.c_uint
    library.hdDisableDevice.argtypes, library.hdDisableDevice.restype = [ctypes.c_uint], None
    library.hdEnable.argtypes = library.hdDisable.argtypes = [ctypes.c_uint]
    library.hdEnable.restype = library.hdDisable.restype = None
    library.hdGetDoublev.argtypes, library.hdGetDoublev.restype = [ctypes.c_uint, ctypes.c_void_p], None
    library.hdStartScheduler.restype = library.hdStopScheduler.restype = None
    library.hdGetError.restype = _ErrorInfo
    schedule = library.hdScheduleAsynchronous
    schedule.argtypes, schedule.restype = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_ushort], ctypes.c_ulong
    library.hdUnschedule.argtypes, library.hdUnschedule.restype = [ctypes.c_ulong], None
