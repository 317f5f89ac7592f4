"""Ultrasound simulator: probe, beam, scan lines, images and volumes."""
