"""`dvf-ig model`."""
