"""Samples of a live session: PLUS field data, the Lab Streaming Layer, or a file that grows."""
