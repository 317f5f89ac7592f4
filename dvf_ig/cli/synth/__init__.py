"""`dvf-ig synth`."""
