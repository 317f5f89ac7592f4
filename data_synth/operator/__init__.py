"""Operator's hands: probe path, tool path, contact with the heart, and a hand that responds to force."""
