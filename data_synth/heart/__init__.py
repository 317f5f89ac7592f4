"""Beating heart: anatomy, motion, mismatch between MR and patient."""
