"""ECG, beats and tracker as they are recorded."""
