"""Beating heart built from the expert's labels of a real cine, which is itself its MR."""
