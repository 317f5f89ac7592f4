"""`dvf-ig study`."""
