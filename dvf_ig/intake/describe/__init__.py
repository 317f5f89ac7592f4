"""Kind and facts of a file, for `dvf-ig inspect`."""
