"""Tracked frames as they arrive, gated, and made into registrations and compared beats."""
