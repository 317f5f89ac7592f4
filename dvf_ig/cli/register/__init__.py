"""`dvf-ig register`."""
