"""Haptic devices: what the servo drives, simulated, recorded, or a vendor's."""
