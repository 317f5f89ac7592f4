"""The pose in use: when it is registered, compared with beats, confirmed, suspended and withheld."""
