"""`dvf-ig serve`: a live session."""
