"""Supervision of the force: hazards, fades, slew limit, latch and re-arm (docs/theory/safety.md)."""
