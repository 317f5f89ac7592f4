"""Synthetic intervention and its ground truth."""
