"""`dvf-ig inspect`."""
