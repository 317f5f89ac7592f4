"""Signed distance to a closed surface: exact, and by dilation as in the paper."""
