"""Registration on many hearts: which hearts for what, one line a trial, rates and intervals over hearts."""
