"""Timing: the cardiac cycle's phases, triggers and retiming."""
