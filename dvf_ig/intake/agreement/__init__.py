"""Whether files that were each read without complaint can be of one intervention."""
