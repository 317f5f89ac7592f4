"""Faults of the streams: what is taken out of them, put into them, or changed between two moments."""
