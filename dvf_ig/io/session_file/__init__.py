"""A lab's own recordings, described by one YAML file: which file is what."""
