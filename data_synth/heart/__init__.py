"""The beating heart: anatomy, motion, breathing, mismatch between MR and patient."""
