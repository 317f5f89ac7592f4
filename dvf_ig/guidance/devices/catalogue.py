"""Haptic devices by the names that a user gives them: opened, listed, and read once without a servo."""

import ctypes
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.guidance.device import DeviceLimits

from .force_dimension import ForceDimensionDevice
from .openhaptics import OpenHapticsDevice
from .protocol import HapticDevice, HeldDevice
from .simulated import DEVICES, SimulatedStylus
from .vendor_library import VendorLibraryError

SIMULATED = "simulated"
VENDORS: dict[str, Callable[[], HeldDevice]] = {
    "force-dimension": ForceDimensionDevice,
    "openhaptics": OpenHapticsDevice,
}
NAMES = (*VENDORS, SIMULATED, *(f"{SIMULATED}:{one}" for one in DEVICES))
"""Every name that `open_device` takes; "simulated" alone is the first of them."""
ANSWERS_WITHIN_S = 0.5

_READ = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int64, ctypes.POINTER(ctypes.c_double))


def open_device(name: str) -> HeldDevice:
    """Open a device by its name, a simulated one at the origin.

    Raises:
        InvalidInputError: no such name; VendorLibraryError: no library, or no device that opens.
    """
    if name in VENDORS:
        return VENDORS[name]()
    kind, _, model = name.partition(":")
    model = model or next(iter(DEVICES))
    if kind != SIMULATED or model not in DEVICES:
        raise InvalidInputError(f"'{name}' is not a haptic device; needed one of {', '.join(NAMES)}")
    return SimulatedStylus(DEVICES[model], np.zeros(3))


def vendor_problem(name: str) -> str | None:
    """Say why a vendor's device cannot be used, with what to do; None if it opens."""
    try:
        VENDORS[name]().close()
    except VendorLibraryError as error:
        return str(error)
    return None


def position_mm(device: HapticDevice) -> FloatArray:
    """Read (3,) mm, frame "device"; for a device that no servo drives.

    Raises:
        InvalidInputError: the device does not answer.
    """
    read, numbers = _READ(int(device.functions[0])), (ctypes.c_double * 3)()
    until_s = time.monotonic() + ANSWERS_WITHIN_S
    while read(device.context.ctypes.data, time.monotonic_ns(), numbers) != 0:
        if time.monotonic() > until_s:
            raise InvalidInputError(f"{device.name} does not answer; check its cable and its power")
        time.sleep(0.001)
    return np.array(numbers)


def limits_of(device: HeldDevice, stated: DeviceLimits) -> DeviceLimits:
    """Return what a device may be asked to render.

    Args:
        stated: by the user; without a name nothing was stated. Where the device's library states limits too,
            the smaller ones hold; where neither does, those of `COMMON_DEVICE`.
    """
    own = device.limits
    if own is None or not stated.name:
        return DeviceLimits(
            stiffness_n_per_m=(own or stated).stiffness_n_per_m,
            continuous_force_n=(own or stated).continuous_force_n,
            friction_n=(own or stated).friction_n,
            name=device.name,
        )
    return replace(
        stated,
        stiffness_n_per_m=min(own.stiffness_n_per_m, stated.stiffness_n_per_m),
        continuous_force_n=min(own.continuous_force_n, stated.continuous_force_n),
    )
