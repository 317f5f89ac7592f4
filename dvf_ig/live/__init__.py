"""A session on what arrives by network: OpenIGTLink in and out, and an ECG from there or elsewhere."""
