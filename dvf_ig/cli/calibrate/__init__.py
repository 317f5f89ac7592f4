"""`dvf-ig calibrate`."""
