"""Haptic devices: what the servo drives, simulated, recorded, or a vendor's."""

from .catalogue import NAMES as NAMES
from .catalogue import limits_of as limits_of
from .catalogue import open_device as open_device
from .catalogue import position_mm as position_mm
from .catalogue import vendor_problem as vendor_problem
from .force_dimension import ForceDimensionDevice as ForceDimensionDevice
from .openhaptics import OpenHapticsDevice as OpenHapticsDevice
from .protocol import HapticDevice as HapticDevice
from .protocol import HeldDevice as HeldDevice
from .simulated import SimulatedStylus as SimulatedStylus
