"""Exact signed distance to a closed surface."""
