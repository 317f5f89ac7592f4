"""Haptic devices: what the servo drives, simulated, recorded, or a vendor's."""

from .force_dimension import ForceDimensionDevice as ForceDimensionDevice
from .openhaptics import OpenHapticsDevice as OpenHapticsDevice
from .protocol import HapticDevice as HapticDevice
from .recorded import RecordedDevice as RecordedDevice
from .simulated import SimulatedStylus as SimulatedStylus
from .vendor_library import VendorLibraryError as VendorLibraryError
