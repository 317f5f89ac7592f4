"""The pose between registrations, from heart beat to heart beat."""
