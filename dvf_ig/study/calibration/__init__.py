"""Whether calibration intervals hold the truth as often as they say."""
