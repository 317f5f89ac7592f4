"""Rows of the table of hazards, by what is disturbed."""
