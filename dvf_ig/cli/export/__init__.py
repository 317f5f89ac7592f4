"""`dvf-ig export …`."""
