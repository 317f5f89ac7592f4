"""Describe a file in a few facts: `dvf-ig inspect`."""
