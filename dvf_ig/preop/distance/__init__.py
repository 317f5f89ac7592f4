"""Signed distance to a closed surface: exact, and as the paper does it."""
