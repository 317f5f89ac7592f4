"""Recordings of ECG, beats and tracker."""
