"""ECG recordings, expert beat annotations, hardware triggers."""
