"""Model files: one .npz with its header and checksum, and the cache of built models."""
