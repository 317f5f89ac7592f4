"""Beating heart: anatomy, motion, breathing, mismatch between MR and patient."""
