"""A scenario folder: its layout, reading and writing it, its truth."""
