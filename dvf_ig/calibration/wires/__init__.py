"""Wires of an N-wire phantom found in B-mode images."""
