"""A rigid pose of a heart that has also changed its shape since its images were made."""
