"""Whole recordings before a session: what must hold of them, and how late their ECG is by the images."""
