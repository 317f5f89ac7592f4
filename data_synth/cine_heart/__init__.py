"""A beating heart made of the expert's labels of a real cine; the cine itself is what MR shows of it."""
