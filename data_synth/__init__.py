"""The synthetic world with its truth."""
