"""Pre-operative cine MR of a synthetic heart."""
