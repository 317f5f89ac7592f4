"""A whole synthetic intervention and its ground truth."""
