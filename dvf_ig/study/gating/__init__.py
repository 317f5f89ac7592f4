"""R peaks and phase against annotated recordings."""
