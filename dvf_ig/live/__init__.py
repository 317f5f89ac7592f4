"""A session on what arrives by network: OpenIGTLink in and out, an ECG beside it, a servo behind it."""
