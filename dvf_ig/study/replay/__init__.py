"""Replays of synthetic interventions: every preset on many seeds, scored against the truth."""
