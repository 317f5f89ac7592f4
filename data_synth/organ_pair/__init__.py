"""Pairs of one 3-D ultrasound and several MR images of an organ that does not beat, with known truth."""
