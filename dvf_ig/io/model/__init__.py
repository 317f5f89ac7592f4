"""Model files: one .npz with its header and check sum, and the cache of models already built."""
