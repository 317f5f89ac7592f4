"""Labels of the heart at end-diastole from a few named points."""
